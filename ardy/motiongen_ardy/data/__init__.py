"""From motion capture to a training set: BVH, retargeting, resampling, captions, mirroring, and the set's own file.

``python -m motiongen_ardy.data build FOLDER LABELS.csv OUT`` makes a set; ``check`` and ``look`` examine it, by figures
and by eye.
"""
