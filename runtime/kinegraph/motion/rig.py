"""`Rig`: the nodes of a user's character, their hierarchy and their rest pose.

Lengths are those of the file; Y is up. A node's local transform is T R S: scaled first, then rotated, then moved
(Khronos, glTF 2.0 specification, 3.5.3). BVH joints are nodes without rotation and scale.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kinegraph.arrays import Floats
from kinegraph.errors import InvalidInputError
from kinegraph.motion.quaternions import from_matrix, to_matrix


@dataclass(frozen=True, eq=False)
class Rig:
    """Nodes in any order, each below its parent.

    Raises:
        InvalidInputError: the parents go round in a circle.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    """Index of each node's parent; -1 for a root."""
    translations: Floats
    """(nodes, 3) at rest, relative to the parent."""
    rotations: Floats
    """(nodes, 4) unit quaternions w, x, y, z at rest."""
    scales: Floats
    """(nodes, 3) at rest."""
    skins: tuple[frozenset[int], ...] = ()
    """Nodes that each skin is bound to; a skeleton without a skin has one of all its joints."""

    def __post_init__(self) -> None:
        if len(self.order) != len(self.parents):
            raise InvalidInputError("its nodes go round in a circle: one is below itself")

    @cached_property
    def children(self) -> tuple[tuple[int, ...], ...]:
        """Children of each node."""
        below: list[list[int]] = [[] for _ in self.parents]
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                below[parent].append(node)
        return tuple(map(tuple, below))

    @cached_property
    def order(self) -> tuple[int, ...]:
        """Nodes with every parent before its children; those on a circle are missing."""
        ready = [node for node, parent in enumerate(self.parents) if parent < 0]
        for node in ready:
            ready += self.children[node]
        return tuple(ready)

    @cached_property
    def joints(self) -> frozenset[int]:
        """Nodes that some skin is bound to."""
        return frozenset().union(*self.skins)

    @cached_property
    def world(self) -> Floats:
        """(nodes, 4, 4) matrices of the rest pose."""
        matrices = np.zeros((len(self.parents), 4, 4))
        matrices[:, :3, :3] = to_matrix(self.rotations) * self.scales[:, None, :]
        matrices[:, :3, 3] = self.translations
        matrices[:, 3, 3] = 1.0
        for node in self.order:
            if self.parents[node] >= 0:
                matrices[node] = matrices[self.parents[node]] @ matrices[node]
        return matrices

    @property
    def positions(self) -> Floats:
        """(nodes, 3) in the world, at rest."""
        return self.world[:, :3, 3]

    @cached_property
    def orientations(self) -> Floats:
        """(nodes + 1, 4) rotations of the nodes in the world, at rest; the last, that of -1, is the identity.

        The polar factors of their matrices; a mirrored node's is turned round (-1 times a reflection is a rotation),
        which leaves `conjugate(q) r q`, the only use, as it is.
        """
        u, _, vt = np.linalg.svd(np.concatenate([self.world[:, :3, :3], np.eye(3)[None]]))
        return from_matrix(u @ vt * np.sign(np.linalg.det(u @ vt))[:, None, None])

    def ancestors(self, node: int) -> Iterator[int]:
        """Yield the node, its parent, and so on up to a root."""
        while node >= 0:
            yield node
            node = self.parents[node]

    def common_ancestor(self, nodes: Iterable[int]) -> int:
        """Find the lowest node at or above all of `nodes`; -1 where there is none."""
        first, *others = nodes
        above = [set(self.ancestors(node)) for node in others]
        return next((node for node in self.ancestors(first) if all(node in line for line in above)), -1)

    def path(self, top: int, bottom: int) -> tuple[int, ...]:
        """List the nodes from `top` down to `bottom`, both included; empty if `bottom` is not below `top`."""
        line: list[int] = []
        for node in self.ancestors(bottom):
            line.append(node)
            if node == top:
                return tuple(reversed(line))
        return ()
