"""SamplingOptions: how a model wants to be sampled. They belong to its checkpoint, not to who runs it.

Without `sampling.yaml` beside the weights a model is sampled as released models are: guidance of text and constraints
apart, 2 and 2, and nothing planned or corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Literal

from motiongen_ardy.model.config import ConfigError, GuidanceMode

PassMode = GuidanceMode | Literal["joint"]
PASS_MODES: tuple[PassMode, ...] = ("joint", "separated", "regular", "none")


def option(default: float, least: float, most: float) -> Any:
    """A field that holds a number from least to most, whole where its default is."""
    return field(default=default, metadata={"least": least, "most": most})


class CheckedOptions:
    """Base of a group of options: every number is checked against its field's range where the group is built."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a value of another kind or outside its range."""
        problems = []
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if "least" in one.metadata:
                least, most, whole = one.metadata["least"], one.metadata["most"], isinstance(one.default, int)
                known = isinstance(value, int) if whole else isinstance(value, (int, float))
                if isinstance(value, bool) or not known or not least <= value <= most:
                    kind = "a whole number" if whole else "a number"
                    problems.append(f"{one.name} is {value!r}; it must be {kind} from {least:g} to {most:g}")
            elif isinstance(one.default, bool) and not isinstance(value, bool):
                problems.append(f"{one.name} is {value!r}; it must be true or false")
        if problems:
            raise ConfigError(problems)


@dataclass(frozen=True)
class GuidanceOptions(CheckedOptions):
    """Which passes a step makes, and the weights of a session that does not say.

    mode: "joint": text and constraints told together, both + (text - 1)(text alone - neither) + (constraint - 1)
    (constraints alone - neither), which is one pass at 1 and 1; "separated", "regular" and "none" as
    `motiongen_ardy.model.denoiser.guidance` has them.
    """

    mode: PassMode = "separated"
    text: float = option(2.0, 0.0, 10.0)
    constraint: float = option(2.0, 0.0, 10.0)

    def __post_init__(self) -> None:
        """Raises ConfigError for a mode that does not exist, or weights outside their range."""
        if self.mode not in PASS_MODES:
            raise ConfigError(f"mode is {self.mode!r}; it must be one of {', '.join(PASS_MODES)}")
        super().__post_init__()


@dataclass(frozen=True)
class ProjectionOptions(CheckedOptions):
    """How the predicted root is brought onto its goals.

    last_steps: at how many of the last denoising steps; all, unless said. slack_m, slack_rad: how far the root may sway
    about a path that was only planned under its goals; settle_frames: less within so many frames of a goal that was
    asked for. acceleration_m_s2: the most that a correction adds where no path was planned. slowing_s: over so long a
    root that nothing leads loses a speed that the network would have it lose at once; 0: it stops as it is told.
    led_steps: a led root is predicted in so many of the first steps, and is kept in the others, where only the body is
    predicted; led_frames: it is led where ground and heading are asked for at each of so many first frames.
    """

    last_steps: int = option(1000, 1, 1000)
    slack_m: float = option(0.03, 0.0, 1.0)
    slack_rad: float = option(0.2, 0.0, 3.2)
    settle_frames: int = option(10, 1, 100)
    acceleration_m_s2: float = option(4.0, 0.1, 50.0)
    slowing_s: float = option(0.6, 0.0, 5.0)
    led_steps: int = option(1000, 1, 1000)
    led_frames: int = option(16, 1, 1000)


@dataclass(frozen=True)
class PlanOptions(CheckedOptions):
    """How a root path is laid under sparse root goals.

    stride_frames: one frame in so many is told to the model. speed_m_s: the fastest that a plan walks of its own
    accord; acceleration_m_s2 and turn_rate_rad_s: the most that it speeds up and turns round. spot_turn_rad_s: how fast
    it turns on the spot where there is time, on average.
    """

    stride_frames: int = option(5, 1, 40)
    speed_m_s: float = option(1.8, 0.1, 10.0)
    acceleration_m_s2: float = option(2.8, 0.1, 50.0)
    turn_rate_rad_s: float = option(3.2, 0.1, 30.0)
    spot_turn_rad_s: float = option(1.1, 0.1, 30.0)


@dataclass(frozen=True)
class FeetOptions(CheckedOptions):
    """How feet in contact are held in place.

    heel_m, toe_m: how high above the ground these joints are when they stand on it. slow_m_s, low_m: one that is below
    both, in height above that, is in contact, slow_share: and one slower than this share of the root's pace; fast_m_s,
    high_m: one above either is not. stride_m: a foot that would slip farther than this in one stance, or turn farther
    than twist_rad, takes a step instead, in which it is lifted by lift_m at most. fade_frames: over so many frames a
    correction goes where a foot is in the air. lower_m: how far the pelvis gives way to a leg that is too short.
    """

    slow_m_s: float = option(0.15, 0.0, 2.0)
    fast_m_s: float = option(1.2, 0.1, 10.0)
    slow_share: float = option(0.3, 0.0, 1.0)
    low_m: float = option(0.03, 0.0, 1.0)
    high_m: float = option(0.06, 0.0, 1.0)
    heel_m: float = option(0.07, 0.0, 1.0)
    toe_m: float = option(0.012, 0.0, 1.0)
    stride_m: float = option(0.6, 0.05, 2.0)
    twist_rad: float = option(1.0, 0.1, 6.3)
    lift_m: float = option(0.06, 0.0, 0.5)
    fade_frames: int = option(10, 1, 100)
    lower_m: float = option(0.05, 0.0, 0.5)


@dataclass(frozen=True)
class JoinOptions(CheckedOptions):
    """How tokens and windows are joined.

    seam_frames: over so many frames a jump at the start of a window fades. free_rad: a joint that turns farther than
    this at the start of a window turns the rest over settle_frames, or up to twice as many where it is far; so does one
    above the legs that sets off faster than the history by more than free_start_rad a frame.
    """

    seam_frames: int = option(8, 1, 100)
    free_rad: float = option(0.2, 0.01, 6.3)
    free_start_rad: float = option(0.05, 0.0, 6.3)
    settle_frames: int = option(14, 1, 100)


@dataclass(frozen=True)
class ReachOptions(CheckedOptions):
    """How joints are brought onto their goals.

    fade_frames: a correction comes and goes over so many frames on either side of its goal. acceleration_m_s2: where
    there is less room, at the start of a window, it is made smaller until it accelerates no joint by more than this,
    and the goal is missed by the rest.
    """

    fade_frames: int = option(8, 1, 100)
    acceleration_m_s2: float = option(40.0, 0.1, 1000.0)


@dataclass(frozen=True)
class PaceOptions(CheckedOptions):
    """When a planned root goes against a prompt, and a gait's is told instead.

    It does where it goes faster than above_share of the fastest usual for the prompt and above_m_s more, or nowhere
    as fast as below_share of the slowest. least_frames: a way that lasts no longer than this is gone under the prompt.
    """

    above_share: float = option(1.5, 1.0, 10.0)
    above_m_s: float = option(0.3, 0.0, 10.0)
    below_share: float = option(0.3, 0.0, 1.0)
    least_frames: int = option(8, 4, 1000)


@dataclass(frozen=True)
class SamplingOptions(CheckedOptions):
    """All of it; the released behaviour unless said otherwise.

    project_root: each step's root is brought onto its goals before the body follows it. plan_root: sparse root goals
    get a path laid under them. clean_feet: feet in contact are held in place. reach_joints: joints are brought onto
    their goals. join_tokens: jumps between one token's frames and the next's are smoothed. face_root: a body that parts
    from its root's heading is turned to it. fit_prompts: a gait's prompt is told where the root is to go at a pace that
    the prompt's motion does not have; which those are, the checkpoint says. approach_frames: where a goal follows on
    a window within fewer frames than these, the window is kept only so far that the goal has as many of the next.
    steered_share: of the denoising steps asked for, what a window of a session takes that a velocity leads under the
    prompt of a gait and that follows on another within a few frames. longest_flight_s: seconds without a foot in
    contact after which a character is lost, and starts anew; 0: it may fly for ever.
    """

    guidance: GuidanceOptions = GuidanceOptions()
    project_root: bool = False
    plan_root: bool = False
    clean_feet: bool = False
    reach_joints: bool = False
    join_tokens: bool = False
    face_root: bool = False
    fit_prompts: bool = False
    approach_frames: int = option(12, 0, 100)
    steered_share: float = option(1.0, 0.05, 1.0)
    longest_flight_s: float = option(0.0, 0.0, 60.0)
    projection: ProjectionOptions = ProjectionOptions()
    plan: PlanOptions = PlanOptions()
    feet: FeetOptions = FeetOptions()
    reach: ReachOptions = ReachOptions()
    joins: JoinOptions = JoinOptions()
    paces: PaceOptions = PaceOptions()

    @property
    def corrects(self) -> bool:
        """Whether frames of a finished window are changed before they are committed."""
        return self.clean_feet or self.reach_joints or self.join_tokens or self.face_root


def released_options(mode: GuidanceMode) -> SamplingOptions:
    """How a model without `sampling.yaml` is sampled. mode: what its `config.yaml` says of guidance."""
    return SamplingOptions(guidance=GuidanceOptions(mode=mode))
