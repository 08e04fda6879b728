"""Ground: motion made on a level floor, put on slopes and steps before it is shown. Pure numpy."""

from motiongen_client.ground.follower import GroundFollower
from motiongen_client.ground.ground import Ground, Heights

__all__ = ["Ground", "GroundFollower", "Heights"]
