"""Sums of decision trees as flat arrays."""

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np


class Trees:
    """Gradient-boosted trees: one score for each output.

    After a pause no node is in the cache of the processor, and fetching them takes most of the time: a node
    has 16 bytes, and its left child is the next node.

    Parameters
    ----------
    table : mapping
        ``first`` (outputs,) float64, scores before any tree; ``root`` and ``output`` (trees,), first node of
        each tree and the output that it adds to; ``links`` (nodes, 2) int32: twice the feature, and 1 more
        where a feature that is NaN goes left, or -1 in a leaf; then the right child; ``value`` (nodes,)
        float64, largest value that goes left, or score of a leaf.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.first = array("d", table["first"])
        self.root, self.output = array("q", table["root"]), array("q", table["output"])
        self.links = array("i", np.ravel(table["links"]).tolist())
        self.value = array("d", np.ravel(table["value"]).tolist())
        self.scores = array("d", self.first)

    def evaluate(self, row: "array[float]") -> None:
        """Put the scores of a row of features into `scores`."""
        for k in range(len(self.first)):
            self.scores[k] = self.first[k]
        for t in range(len(self.root)):
            node = self.root[t]
            link = self.links[2 * node]
            while link >= 0:
                value = row[link >> 1]
                goes_left = (link & 1) == 1 if value != value else value <= self.value[node]
                node = node + 1 if goes_left else self.links[2 * node + 1]
                link = self.links[2 * node]
            self.scores[self.output[t]] += self.value[node]
