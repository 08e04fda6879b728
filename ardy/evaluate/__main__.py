"""Judge a model: `python -m ardy.evaluate MODEL DATA`; the exit code is 1 where a bound is missed."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import torch

from ardy.checkpoint import load_checkpoint
from ardy.data.dataset import MotionDataset
from ardy.denoiser.guidance import GuidanceWeights
from ardy.evaluate.cases import captured_figures, load_cases
from ardy.evaluate.context import QUICK, Context, Size
from ardy.evaluate.rows.table import FAMILIES
from ardy.evaluate.sampler import Sampler, Sampling
from ardy.model_card import model_folder
from ardy.text import load_text_encoder
from ardy.train.feature_bank import natural_layout
