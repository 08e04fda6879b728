"""The robot as an MJCF model, so that exported qpos can be replayed and measured in MuJoCo without its meshes."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from motiongen_ardy.robot.g1 import Body, load_g1

_LIMB_RADIUS_M = 0.02
_MASS_KG = 1.0


def g1_mjcf() -> str:
    """MJCF text: the bodies of `g1.json` with their hinges, and a capsule on every bone for display.

    The kinematics are the robot's; the masses are not (one kilogram per body), so do not simulate forces with it.
    """
    bodies = load_g1().bodies
    model = ElementTree.Element("mujoco", model="g1")
    ElementTree.SubElement(model, "compiler", angle="radian", autolimits="true")
    world = ElementTree.SubElement(model, "worldbody")
    ElementTree.SubElement(world, "geom", name="floor", type="plane", size="0 0 1", contype="0", conaffinity="0")
    nodes: dict[str | None, ElementTree.Element] = {None: world}
    for body in bodies:
        nodes[body.name] = _body_node(
            nodes[body.parent], body, [other for other in bodies if other.parent == body.name]
        )
    ElementTree.indent(model)
    return ElementTree.tostring(model, encoding="unicode")


def _body_node(parent: ElementTree.Element, body: Body, children: list[Body]) -> ElementTree.Element:
    position, quaternion = _numbers(body.position), _numbers(body.quaternion)
    node = ElementTree.SubElement(parent, "body", name=body.name, pos=position, quat=quaternion)
    if body.hinge is None:
        ElementTree.SubElement(node, "freejoint", name="floating_base_joint")
    else:
        reach = _numbers((body.lower, body.upper))
        name = f"{body.hinge}_joint"
        ElementTree.SubElement(node, "joint", name=name, type="hinge", axis=_numbers(body.axis), range=reach)
    ElementTree.SubElement(node, "inertial", pos="0 0 0", mass=f"{_MASS_KG}", diaginertia="0.01 0.01 0.01")
    drawn = {"contype": "0", "conaffinity": "0", "size": f"{_LIMB_RADIUS_M}"}
    ElementTree.SubElement(node, "geom", {"type": "sphere", **drawn})
    for child in children:
        if any(child.position):
            ends = _numbers((0.0, 0.0, 0.0, *child.position))
            ElementTree.SubElement(node, "geom", {"type": "capsule", "fromto": ends, **drawn})
    return node


def _numbers(values: Iterable[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)
