"""Sums of decision trees as flat arrays."""

from array import array
from collections.abc import Mapping
from typing import Any


class Trees:
    """Gradient-boosted trees: one score for each output.

    Parameters
    ----------
    table : mapping
        ``first`` (outputs,) float64, scores before any tree; ``root`` and ``output`` (trees,) int64, first
        node of each tree and the output that it adds to; ``feature``, ``left`` and ``right`` (nodes,) int64,
        with a feature of -1 in a leaf; ``value`` (nodes,) float64, threshold of a node or score of a leaf;
        ``missing_left`` (nodes,) int64, 1 where a feature that is NaN goes left.
    """

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.first = array("d", table["first"])
        self.root, self.output = array("q", table["root"]), array("q", table["output"])
        self.feature, self.left = array("q", table["feature"]), array("q", table["left"])
        self.right, self.missing_left = array("q", table["right"]), array("q", table["missing_left"])
        self.value = array("d", table["value"])
        self.scores = array("d", self.first)

    def evaluate(self, row: "array[float]") -> None:
        """Put the scores of a row of features into `scores`."""
        for k in range(len(self.first)):
            self.scores[k] = self.first[k]
        for t in range(len(self.root)):
            node = self.root[t]
            feature = self.feature[node]
            while feature >= 0:
                value = row[feature]
                if value != value:
                    goes_left = self.missing_left[node] == 1
                else:
                    goes_left = value <= self.value[node]
                node = self.left[node] if goes_left else self.right[node]
                feature = self.feature[node]
            self.scores[self.output[t]] += self.value[node]
