"""The errors that training commands answer with a message and exit code 2: input or a run that cannot be used."""

from motiongen_ardy.core.problems import Problems
from motiongen_ardy.core.skeleton import UnknownSkeleton
from motiongen_ardy.data.dataset import DatasetError
from motiongen_ardy.text.encoder import TextEncoderUnavailable, TextWidthMismatch, UnknownTextEncoder
from motiongen_ardy.train.loop import Diverged
from motiongen_ardy.train.run_folder import ResumeError, RunFolderError

UNUSABLE = (
    Problems, UnknownSkeleton, DatasetError, UnknownTextEncoder, TextWidthMismatch, TextEncoderUnavailable,
    ResumeError, RunFolderError, Diverged,
)  # fmt: skip
