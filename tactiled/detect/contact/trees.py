"""Gradient-boosted trees, evaluated for one row of features after the other.

The file is plain Python, which Cython compiles with the types of `trees.pxd` (`tactiled.compiled`).
"""

from array import array
from bisect import bisect
from collections.abc import Mapping
from typing import Any

import numpy as np

_ALL_LEAVES, _MOST_LEAVES = 0xFFFFFFFF, 32  # derived: a bit for each leaf of a tree, in 32 bits
# derived: the five highest bits of a power of two times this number (modulo 2^32) are another number for each
# power (Leiserson, Prokop and Randall 1998), which is looked up
_DE_BRUIJN = 0x077CB531
_PLACES = array("i", sorted(range(_MOST_LEAVES), key=lambda bit: (_DE_BRUIJN << bit & _ALL_LEAVES) >> 27))


class Trees:
    """Gradient-boosted trees as flat arrays: one score for each output.

    No tree is walked. Each condition of a tree that a row fails crosses out the leaves on its left; the first
    leaf that is left is where the row goes (QuickScorer, Lucchese et al., SIGIR 2015). Conditions are sorted
    by feature and limit, so that those which fail come first: after a pause, memory is read in one go.

    Parameters
    ----------
    table : mapping
        ``first`` (outputs,) float64, scores before any tree; ``root`` and ``output`` (trees,), first node of
        each tree and the output that it adds to; ``links`` (nodes, 2) int32: twice the feature, and 1 more
        where a feature that is NaN goes left, or -1 in a leaf; then the right child (the left one is the next
        node); ``value`` (nodes,) float64, largest value that goes left, or score of a leaf.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        links, value = np.reshape(table["links"], (-1, 2)).tolist(), np.ravel(table["value"]).tolist()
        conditions: list[tuple[int, float, int, int, int]] = []
        leaves: list[float] = []
        leaf_of: list[int] = []  # of each tree, its first leaf

        def take(node: int, tree: int) -> int:
            """Take what is below a node; return how many leaves of the tree there are so far."""
            link, right = links[node]
            if link < 0:
                leaves.append(value[node])
                return len(leaves) - leaf_of[tree]
            before = len(leaves) - leaf_of[tree]
            up_to = take(node + 1, tree)
            left = _ALL_LEAVES ^ (1 << up_to) - (1 << before)
            conditions.append((link >> 1, value[node], link & 1, tree, left))
            return take(right, tree)

        self.first, self.output = array("d", table["first"]), array("i", table["output"])
        for tree, root in enumerate(table["root"]):
            leaf_of.append(len(leaves))
            if take(int(root), tree) > _MOST_LEAVES:
                raise ValueError(f"a tree has more than {_MOST_LEAVES} leaves")
        conditions.sort()
        n_features = max([one[0] for one in conditions], default=-1) + 1
        self.of_feature = array("i", [bisect(conditions, (k,)) for k in range(n_features + 1)])
        self.limit = array("d", [one[1] for one in conditions])
        self.nan_fails = array("b", [1 - one[2] for one in conditions])
        self.tree = array("i", [one[3] for one in conditions])
        self.left = array("I", [one[4] for one in conditions])  # leaves that are left where it fails
        self.leaf, self.leaf_of = array("d", leaves), array("i", leaf_of)
        self.reached = array("I", [_ALL_LEAVES] * len(self.output))
        self.scores = array("d", self.first)

    def evaluate(self, row: "array[float]") -> None:
        """Put the scores of a row of features into `scores`."""
        for t in range(len(self.output)):
            self.reached[t] = _ALL_LEAVES
        for feature in range(len(self.of_feature) - 1):
            value, end = row[feature], self.of_feature[feature + 1]
            for k in range(self.of_feature[feature], end):
                if value > self.limit[k] or (value != value and self.nan_fails[k]):
                    self.reached[self.tree[k]] &= self.left[k]
                elif value == value:
                    break  # the other limits are not less
        for k in range(len(self.first)):
            self.scores[k] = self.first[k]
        for t in range(len(self.output)):
            lowest = self.reached[t] & (~self.reached[t] + 1)
            place = _PLACES[(lowest * _DE_BRUIJN & _ALL_LEAVES) >> 27]
            self.scores[self.output[t]] += self.leaf[self.leaf_of[t] + place]
