"""The node movers: what moves and where it will be, for move_base's costmaps, the policy and display."""
