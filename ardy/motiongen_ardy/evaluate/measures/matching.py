"""R-precision and Frechet distance (FID) of motion and text vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

POOL = 32


def ranks(motions: Tensor, texts: Tensor, labels: Sequence[str], seed: int = 0) -> np.ndarray:
    """The rank (N), from 0, of each motion's own text among POOL texts of different labels.

    motions, texts: (N, K) unit vectors; labels: texts with the same label mean the same and are never in one pool. The
    pool is smaller if there are fewer labels.
    """
    random = np.random.default_rng(seed)
    scores = (motions @ texts.T).numpy()
    places = []
    for row, label in enumerate(labels):
        pool: dict[str, int] = {}
        for other in random.permutation(len(labels)):
            if labels[other] != label:
                pool.setdefault(labels[other], int(other))
            if len(pool) == POOL - 1:
                break
        places.append(int((scores[row, list(pool.values())] > scores[row, row]).sum()))
    return np.array(places)


def frechet_distance(first: Tensor, second: Tensor) -> float:
    """The distance between two sets of vectors (N, K) as Gaussians (Heusel et al. 2017, eq. 6)."""
    a, b = first.double(), second.double()
    mean = (a.mean(dim=0) - b.mean(dim=0)).square().sum()
    cov_a, cov_b = torch.cov(a.T), torch.cov(b.T)
    # The trace of the square root of the product, from the eigenvalues of a symmetric form of it.
    values, vectors = torch.linalg.eigh(cov_a)
    root = vectors @ torch.diag(values.clamp(min=0).sqrt()) @ vectors.T
    crossed = torch.linalg.eigvalsh(root @ cov_b @ root).clamp(min=0).sqrt().sum()
    return float(mean + cov_a.trace() + cov_b.trace() - 2 * crossed)
