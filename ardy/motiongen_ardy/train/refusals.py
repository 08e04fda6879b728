"""What the commands of training answer with a message and exit code 2: input that cannot be used."""

from motiongen_ardy.core.problems import Problems
from motiongen_ardy.data.dataset import DatasetError
from motiongen_ardy.text.encoder import TextEncoderUnavailable, TextWidthMismatch, UnknownTextEncoder
from motiongen_ardy.train.loop import ResumeError

UNUSABLE = (Problems, DatasetError, UnknownTextEncoder, TextWidthMismatch, TextEncoderUnavailable, ResumeError)
