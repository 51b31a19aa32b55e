"""Formulas as Blender shader nodes: ordinary arithmetic on `Value`s builds the tree."""

from __future__ import annotations

from typing import Any

import numpy as np


class Value:
    """Output of a node: a number or three (a vector or a colour) at every point of a surface.

    Arithmetic is by component; numbers stand for three equal ones where three are needed.

    Args:
        tree: node tree.
        socket: output of one of its nodes.
        triple: whether it has three components.
    """

    __array_ufunc__ = None  # an array on the left leaves the arithmetic to the methods below

    def __init__(self, tree: Any, socket: Any, triple: bool) -> None:
        self.tree, self.socket, self.triple = tree, socket, triple

    def __add__(self, other: Any) -> Value:
        return self._combined("ADD", self, other)

    def __radd__(self, other: Any) -> Value:
        return self._combined("ADD", other, self)

    def __sub__(self, other: Any) -> Value:
        return self._combined("SUBTRACT", self, other)

    def __rsub__(self, other: Any) -> Value:
        return self._combined("SUBTRACT", other, self)

    def __mul__(self, other: Any) -> Value:
        return self._combined("MULTIPLY", self, other)

    def __rmul__(self, other: Any) -> Value:
        return self._combined("MULTIPLY", other, self)

    def __gt__(self, other: float) -> Value:
        """1 where it is larger, else 0."""
        return self.mapped("GREATER_THAN", other)

    def __lt__(self, other: float) -> Value:
        """1 where it is smaller, else 0."""
        return self.mapped("LESS_THAN", other)

    def mapped(self, operation: str, *others: float) -> Value:
        """A function of Blender's math node, such as SINE or ABSOLUTE, of a number."""
        return Value(self.tree, add_node(self.tree, "ShaderNodeMath", [self, *others], operation=operation)[0], False)

    def mixed(self, other: Any, share: Any) -> Value:
        """This where `share` is 0, `other` where it is 1."""
        return self + (other - self) * share

    def smoothstep(self, low: float, high: float) -> Value:
        """0 below `low`, 1 above `high`, a cubic between."""
        inputs = {"Value": self, "From Min": low, "From Max": high}
        outputs = add_node(self.tree, "ShaderNodeMapRange", inputs, interpolation_type="SMOOTHSTEP")
        return Value(self.tree, outputs["Result"], False)

    def components(self) -> tuple[Value, Value, Value]:
        """The three numbers of a triple."""
        x, y, z = (Value(self.tree, output, False) for output in add_node(self.tree, "ShaderNodeSeparateXYZ", [self]))
        return x, y, z

    def _combined(self, operation: str, left: Any, right: Any) -> Value:
        triple = any(side.triple if isinstance(side, Value) else np.ndim(side) == 1 for side in (left, right))
        kind = "ShaderNodeVectorMath" if triple else "ShaderNodeMath"
        return Value(self.tree, add_node(self.tree, kind, [left, right], operation=operation)[0], triple)


def add_node(tree: Any, kind: str, inputs: dict[str, Any] | list[Any], **settings: Any) -> Any:
    """Adds a node.

    Args:
        tree: node tree.
        kind: Blender's type name of the node.
        inputs: what goes into it, by name or in order: values, outputs of other nodes, numbers or triples.
        settings: the node's other properties.

    Returns:
        Its outputs.
    """
    node = tree.nodes.new(kind)
    for name, setting in settings.items():
        setattr(node, name, setting)
    for key, given in inputs.items() if isinstance(inputs, dict) else enumerate(inputs):
        socket = node.inputs[key]
        if isinstance(given, Value):
            tree.links.new(given.socket, socket)
        elif hasattr(given, "is_output"):
            tree.links.new(given, socket)
        elif socket.type == "VECTOR":
            socket.default_value = np.broadcast_to(given, 3).tolist()
        elif socket.type == "RGBA":
            socket.default_value = (*np.broadcast_to(given, 3).tolist(), 1.0)
        else:
            socket.default_value = float(given)
    return node.outputs


def attribute(tree: Any, name: str, *, triple: bool = False) -> Value:
    """What a mesh stores under a name, between its vertices interpolated."""
    outputs = add_node(tree, "ShaderNodeAttribute", [], attribute_name=name)
    return Value(tree, outputs["Vector" if triple else "Fac"], triple)


def noise(position: Value, frequency: float) -> Value:
    """Smooth noise about 0 with so many periods per metre, as strong as the shaders': it keeps to -0.5..0.5 nearly."""
    inputs = {"Vector": position, "Scale": frequency, "Detail": 0.0}
    return Value(position.tree, add_node(position.tree, "ShaderNodeTexNoise", inputs)["Fac"], False) * 1.4 - 0.7
