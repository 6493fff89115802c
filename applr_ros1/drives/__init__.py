"""A recorded drive as a picture and as an animation; knows nothing of ROS."""
