"""Layout files of other viewers name only topics, fields and metrics that exist."""

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import fields
from typing import Any

import pytest

from tactiled.daemon.operations.metrics import METRICS
from tactiled.events.types import EVENT_TYPES
from tactiled.resources import shipped
from tactiled.zenoh.fleet import FLEET_METRICS

VIEWERS = shipped("config", "viewers")


def leaves(value: Any) -> list[str]:
    """All texts in a document."""
    if isinstance(value, dict):
        return [text for inner in value.values() for text in leaves(inner)]
    if isinstance(value, list):
        return [text for inner in value for text in leaves(inner)]
    return [value] if isinstance(value, str) else []


def assert_field(topic: str, path: str) -> None:
    first = re.split(r"[.\[]", path)[0]
    assert first in {field.name for field in fields(EVENT_TYPES[topic])}, f"{topic}.{path}"


def test_every_path_of_foxglove_is_in_a_recording() -> None:
    document = json.loads((VIEWERS / "foxglove.json").read_text())
    topics = [text for text in leaves(document["configById"]) if text.startswith("/")]
    assert topics
    for text in topics:
        topic, _, path = text.partition(".")
        if path:
            assert_field(topic.removeprefix("/tactile/"), path)
        else:
            assert topic.removeprefix("/tactile/") in EVENT_TYPES
    plots = [panel for panel in document["configById"].values() if "paths" in panel]
    # Other times are those of a header, which tactiled's own messages do not have: the curves would be empty.
    assert {path["timestampMethod"] for plot in plots for path in plot["paths"]} == {"receiveTime"}
    panels = set(document["configById"])
    assert {text for text in leaves(document["layout"]) if "!" in text} == panels


def test_every_curve_of_plotjuggler_is_a_field_of_a_message() -> None:
    root = ET.parse(VIEWERS / "plotjuggler.xml").getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    assert curves
    for curve in curves:
        prefix, board, topic, path = curve.split("/")
        assert (prefix, board) == ("tactile", "TS0001")
        assert_field(topic, path)
    for splitter in root.iter("DockSplitter"):
        assert (
            int(splitter.attrib["count"]) == len(list(splitter)) == len(splitter.attrib["sizes"].split(";"))
        )


def test_every_metric_of_grafana_is_published() -> None:
    document = json.loads((VIEWERS / "grafana.json").read_text())
    names = {name for text in leaves(document) for name in re.findall(r"tactiled_([a-z_]+)", text)}
    assert len(names) >= 10
    assert {name.removesuffix("_bucket") for name in names} <= METRICS.keys()


def test_every_metric_of_an_alert_is_published() -> None:
    names = set(re.findall(r"tactiled_(\w+)", (VIEWERS / "prometheus-alerts.yml").read_text()))
    assert "missing_ratio" in names
    published = METRICS.keys() | FLEET_METRICS.keys()
    assert {re.sub("_(bucket|sum|count)$", "", name) for name in names} <= published


@pytest.mark.parametrize("name", ["grafana.json", "foxglove.json"])
def test_no_panel_overlaps_or_repeats(name: str) -> None:
    document = json.loads((VIEWERS / name).read_text())
    places = [
        (x, y)
        for panel in document.get("panels", ())
        for x in range(panel["gridPos"]["x"], panel["gridPos"]["x"] + panel["gridPos"]["w"])
        for y in range(panel["gridPos"]["y"], panel["gridPos"]["y"] + panel["gridPos"]["h"])
    ]
    assert len(places) == len(set(places))
