"""The actors that APPLR's authors published with the BARN Challenge, as a method. run.py evaluates one."""

from applr_ros1.policy.methods import ForeignActor


class BarnActor(ForeignActor):
    """721 inputs, seven parameters (there is no occdist_scale), a decision every second."""

    size = 721
    period = 1.0
    ranges = {
        "max_vel_x": (0.2, 2.0),
        "max_vel_theta": (0.314, 3.14),
        "vx_samples": (4, 12),
        "vtheta_samples": (8, 40),
        "pdist_scale": (0.1, 1.5),
        "gdist_scale": (0.1, 2.0),
        "inflation_radius": (0.1, 0.6),
    }

    def inputs(self, context):
        """(r - 1) / 2 of the ranges r capped at 2 m, and phi / (2 pi): half of what our observation begins with."""
        return context.observation[:721] / 2.0
