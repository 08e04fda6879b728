"""Golden vectors of game engines' axes, and of steering."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np

from motiongen_client import GODOT, ROS, UNITY, UNREAL, camera_relative, drawn_corners, stick_velocity
from tests.client.golden.draws import drawn_rotations, numbers


def axes() -> Iterator[str]:
    draw = random.Random(1)
    for engine in (UNREAL, UNITY, GODOT, ROS):
        for _ in range(4):
            place = [draw.uniform(-10, 10) for _ in range(3)]
            turn = drawn_rotations(draw, 1)[0]
            moved = (*engine.positions(place), *engine.quaternions_xyzw(turn))
            yield f"{engine.name} {numbers(place)} {numbers(turn)} -> {numbers(moved)}"


def steering() -> Iterator[str]:
    draw = random.Random(2)
    for _ in range(16):
        right, forward = draw.uniform(-1, 1), draw.uniform(-1, 1)
        camera, speed, dead_zone = draw.uniform(-4, 4), draw.uniform(0.5, 4), draw.choice([0, 0.15, 0.6])
        found = stick_velocity(right, forward, camera_heading_rad=camera, speed_mps=speed, dead_zone=dead_zone)
        yield f"stick {numbers((right, forward, camera, speed, dead_zone))} -> {numbers(found)}"
        yield f"camera {numbers((right, forward, camera))} -> {numbers(camera_relative(right, forward, camera))}"
    for count, within_m in ((1, 0.1), (2, 0.1), (40, 0.1), (40, 0.5), (600, 0.01)):
        points = np.cumsum([[draw.gauss(0, 0.2), draw.gauss(0, 0.2)] for _ in range(count)], axis=0)
        points = np.array([[float(f"{value:.5g}") for value in point] for point in points])
        corners = drawn_corners(points, within_m=within_m)
        yield f"corners {within_m} {numbers(points)} -> {numbers(corners)}"
