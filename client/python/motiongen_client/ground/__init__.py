"""Ground: adapts motion made on a level floor to slopes and steps, on the client. Pure numpy."""

from motiongen_client.ground.follower import GroundFollower
from motiongen_client.ground.ground import Ground, Heights

__all__ = ["Ground", "GroundFollower", "Heights"]
