"""SamplingOptions: how a model is to be sampled. They belong to its checkpoint, not to the program that runs it.

Without `sampling.yaml` beside the weights, a model is sampled as the released models are: separated guidance with both
weights 2, and nothing planned or corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Literal

from motiongen_ardy.model.config import ConfigError, GuidanceMode

PassMode = GuidanceMode | Literal["joint"]
PASS_MODES: tuple[PassMode, ...] = ("joint", "separated", "regular", "none")


def option(default: float, least: float, most: float) -> Any:
    """A field that holds a number from least to most; whole numbers only, if the default is one."""
    return field(default=default, metadata={"least": least, "most": most})


class CheckedOptions:
    """Base of a group of options: on construction, every number is checked against its field's range."""

    def __post_init__(self) -> None:
        """Raises ConfigError for a value of the wrong type or outside its range."""
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
    """Which passes a step makes, and the default weights of a session.

    mode: "joint": text and constraints in one pass, both + (text - 1)(text alone - neither) + (constraint - 1)
    (constraints alone - neither), a single pass if both weights are 1; "separated", "regular" and "none" as in
    `motiongen_ardy.model.denoiser.guidance`.
    """

    mode: PassMode = "separated"
    text: float = option(2.0, 0.0, 10.0)
    constraint: float = option(2.0, 0.0, 10.0)

    def __post_init__(self) -> None:
        """Raises ConfigError for an unknown mode, or weights outside their range."""
        if self.mode not in PASS_MODES:
            raise ConfigError(f"mode is {self.mode!r}; it must be one of {', '.join(PASS_MODES)}")
        super().__post_init__()


@dataclass(frozen=True)
class ProjectionOptions(CheckedOptions):
    """How the predicted root is projected onto its goals.

    last_steps: in how many of the last denoising steps; by default all.
    slack_m, slack_rad: how far the root may sway about a path that was only planned.
    settle_frames: within so many frames of a goal that was asked for, it may sway less.
    acceleration_m_s2: the most that a correction adds if no path was planned.
    slowing_s: how long a root without goals takes to lose a speed that the network would stop at once; 0: no time.
    led_steps: a led root is predicted in so many of the first steps and kept in the others, which only predict bodies.
    led_frames: a root is led if ground position and heading are asked for at each of so many first frames.
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
    """How a root path is planned to sparse root goals.

    stride_frames: every stride_frames-th frame of the path is given to the model.
    speed_m_s: the fastest walk that a plan chooses of itself.
    acceleration_m_s2, turn_rate_rad_s: limits of acceleration and turning.
    spot_turn_rad_s: average speed of turns on the spot if there is time.
    """

    stride_frames: int = option(5, 1, 40)
    speed_m_s: float = option(1.8, 0.1, 10.0)
    acceleration_m_s2: float = option(2.8, 0.1, 50.0)
    turn_rate_rad_s: float = option(3.2, 0.1, 30.0)
    spot_turn_rad_s: float = option(1.1, 0.1, 30.0)


@dataclass(frozen=True)
class FeetOptions(CheckedOptions):
    """How feet in contact are held in place.

    A joint is in contact if it is less than low_m above its standing height and slower than slow_m_s, or slower than
    slow_share of the root's pace; it is not if it is faster than fast_m_s or higher than high_m.
    heel_m, toe_m: heights of these joints when they stand on the ground.
    stride_m, twist_rad: a foot that would slip or turn farther than this in one stance takes a step instead.
    lift_m: the most by which it is lifted in that step.
    fade_frames: over how many frames a correction fades while a foot is in the air.
    lower_m: the most by which the pelvis is lowered for a leg that is too short.
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

    seam_frames: over how many frames a jump at the start of a window fades.
    free_rad: a joint that turns farther than this at the start of a window makes up the rest over settle_frames, or up
    to twice as many if it is far.
    free_start_rad: so does one above the legs that starts faster than in the history by more than this per frame.
    """

    seam_frames: int = option(8, 1, 100)
    free_rad: float = option(0.2, 0.01, 6.3)
    free_start_rad: float = option(0.05, 0.0, 6.3)
    settle_frames: int = option(14, 1, 100)


@dataclass(frozen=True)
class ReachOptions(CheckedOptions):
    """How joints are brought onto their goals.

    fade_frames: over how many frames a correction grows before its goal and fades after it.
    acceleration_m_s2: if there is less room, at the start of a window, the correction is reduced until no joint is
    accelerated by more than this, and the goal is missed by the rest.
    """

    fade_frames: int = option(8, 1, 100)
    acceleration_m_s2: float = option(40.0, 0.1, 1000.0)


@dataclass(frozen=True)
class PaceOptions(CheckedOptions):
    """When a planned root contradicts its prompt, so that a gait's prompt is used instead.

    above_share, above_m_s: it does if it goes faster than above_share times the prompt's usual greatest speed, plus
    above_m_s.
    below_share: it also does if it is never as fast as this share of the prompt's usual least speed.
    least_frames: shorter ways keep the prompt.
    """

    above_share: float = option(1.5, 1.0, 10.0)
    above_m_s: float = option(0.3, 0.0, 10.0)
    below_share: float = option(0.3, 0.0, 1.0)
    least_frames: int = option(8, 4, 1000)


@dataclass(frozen=True)
class SamplingOptions(CheckedOptions):
    """All sampling options; the defaults are those of the released models.

    project_root: in each step, the root is projected onto its goals before the body follows it.
    plan_root: a path is planned to sparse root goals.
    clean_feet: feet in contact are held in place.
    reach_joints: joints are brought onto their goals.
    join_tokens: jumps between the frames of one token and the next are smoothed.
    face_root: a body that departs from its root's heading is turned to it.
    fit_prompts: where the root has to go at a pace that the prompt's motion does not have, a gait's prompt is used; the
    checkpoint's paces say which.
    approach_frames: if a goal lies fewer frames than this behind a window, the window is cut short so that the goal has
    so many of the next.
    steered_share: share of the requested denoising steps, for a window that a velocity leads under the prompt of a gait
    and that follows another within a few frames.
    longest_flight_s: seconds without foot contact after which a character is lost and starts anew; 0: no limit.
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
    """How a model without `sampling.yaml` is sampled. mode: the guidance mode in its `config.yaml`."""
    return SamplingOptions(guidance=GuidanceOptions(mode=mode))
