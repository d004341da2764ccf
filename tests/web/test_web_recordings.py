"""Recordings of a directory: listed, sent and opened, and nothing else of the disk."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from page_server import Answer, answers
from pages import robot
from playwright.sync_api import Page, expect
from recordings import record, simulated_reads
from stage import stage

from tactiled.resources import shipped
from tactiled.web import recordings
from tactiled.web.replay import ReplayFile
from tactiled.web.server import Listening

NAME = "tactile-20260102T030405.678Z.mcap"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a recording, what is none, and a file beside the directory."""
    folder = tmp_path_factory.mktemp("all") / "recordings"
    folder.mkdir()
    record(folder / NAME, simulated_reads(8.0, "demo"))
    (folder / "no.mcap").write_bytes(b"nothing")
    (folder / "keys.toml").write_text("secret")
    (folder.parent / "beside.mcap").write_bytes(b"secret")
    (folder / "link.mcap").symlink_to(folder.parent / "beside.mcap")
    (folder / "folder.mcap").mkdir()
    return folder


def serve(folder: Path | None, *asked: str, method: str = "GET") -> list[Answer]:
    return answers(Listening([], port=0, recordings=folder), *((method, path) for path in asked))


def test_the_recordings_of_the_directory_are_listed_and_sent_as_they_are(folder: Path) -> None:
    listed, sent = serve(folder, "api/recordings", f"api/recordings/{NAME}")
    assert {row["name"] for row in listed.json} == {NAME, "no.mcap"}
    (row,) = [row for row in listed.json if row["name"] == NAME]
    assert (row["bytes"], row["opens"]) == ((folder / NAME).stat().st_size, True)
    assert (sent.status, sent.body) == (200, (folder / NAME).read_bytes())


@pytest.mark.parametrize(
    "name",
    ["../beside.mcap", "..%2Fbeside.mcap", "%2E%2E%2Fbeside.mcap", "link.mcap", "keys.toml", "folder.mcap",
     "..", "", "%00", "x" * 5000, "{folder}/../beside.mcap", "recordings%2Fno.mcap"],
)  # fmt: skip
def test_no_name_leads_to_another_file(folder: Path, name: str) -> None:
    named = name.format(folder=str(folder).replace("/", "%2F"))
    found = serve(folder, f"api/recordings/{named}", f"api/session?recording={named}")
    assert [answer.status for answer in found] == [404, 404]
    assert all(b"secret" not in answer.body for answer in found)


def test_nothing_is_written(folder: Path) -> None:
    for method in ("POST", "PUT", "DELETE"):
        assert serve(folder, f"api/recordings/{NAME}", method=method)[0].status == 405
    assert serve(None, "api/recordings")[0].status == 404


def test_a_recording_is_opened_beside_the_live_boards(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    query = f"recording={NAME}"
    opened, stretch, live, none, no = serve(
        folder,
        f"api/session?{query}",
        f"api/replay?{query}&from=0&to=2",
        "api/session",
        "api/replay?from=0&to=2",
        "api/session?recording=no.mcap",
    )
    assert opened.json["replay"]["name"] == NAME
    assert opened.json["recordings"] is live.json["recordings"] is True
    topics = [row[1] for row in stretch.json["m"]]
    assert topics[0] == "geometry"  # of the array in the head of the file
    assert topics.count("scan") > 100
    assert live.json["replay"] is None
    assert (none.status, no.status) == (404, 404)
    assert "not a recording" in no.json["reason"]
    assert str(folder) not in no.json["reason"]
    monkeypatch.setattr(recordings, "LARGEST_BYTES", 1000)
    (large,) = serve(folder, f"api/session?{query}")
    assert "larger" in large.json["reason"]


def test_a_recording_that_vanishes_while_the_list_is_made_costs_only_itself(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    present = [*folder.iterdir()]
    with monkeypatch.context() as patched:
        patched.setattr(Path, "iterdir", lambda _: iter([folder / "archived.mcap", *present]))
        listed = recordings.RecordingFolder(folder).listed()
    assert {row["name"] for row in listed} == {NAME, "no.mcap"}


@pytest.mark.parametrize("step_s", [3.2e7, -3600.0, -3.0])
def test_a_step_of_the_wall_clock_leaves_a_recording_whole(tmp_path: Path, step_s: float) -> None:
    reads = simulated_reads(3.0)
    half = len(reads) // 2
    stepped = [replace(read, unix_offset_s=read.unix_offset_s + step_s) for read in reads[half:]]
    record(tmp_path / NAME, reads[:half] + stepped)
    replay = ReplayFile([tmp_path / NAME])
    assert replay.end_s - replay.start_s == pytest.approx(3.0, abs=1.0)
    scans = [row[2]["index"] for row in json.loads(replay.stretch(0.0, 4.0))["m"] if row[1] == "scan"]
    assert len(scans) > 200
    assert scans == sorted(scans)


def test_the_largest_recording_that_is_opened_fits_into_the_memory_of_the_unit() -> None:
    """One has about ten times as many bytes in memory as on disk."""
    unit = shipped("systemd", "tactiled-web.service").read_text()
    most_mb = re.search(r"^MemoryMax=(\d+)M$", unit, re.MULTILINE)
    assert most_mb is not None
    assert float(most_mb[1]) > 60.0 + 10 * recordings.LARGEST_BYTES / 1e6
    assert f"at most {recordings.LARGEST_BYTES / 1e6:g} MB" in unit


@pytest.mark.system
def test_a_person_opens_a_recording_and_comes_back(folder: Path, page: Page, tmp_path: Path) -> None:
    with robot(tmp_path) as made, stage(tmp_path, ("TS0001", "demo", 12.0)) as made.endpoint:
        url = made.serve("--recordings", str(folder))
        page.goto(url)
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        page.keyboard.press("r")
        page.get_by_role("link", name=f"Open {NAME}").click()
        expect(page.locator(".lamp")).to_have_attribute("data-state", "replay")
        page.locator("body").press("End")
        expect(page.locator(".advice")).to_contain_text("slip", ignore_case=True)
        page.keyboard.press("m")
        expect(page.locator(".events .list")).to_contain_text("mark 1")
        page.locator("#copy").click()
        expect(page.locator("#copy")).not_to_have_text("Copy link")
        assert page.url.startswith(f"{url}?recording={NAME}#at=")
        page.locator("body").press("Home")
        expect(page.locator("#clock")).to_contain_text("0.00 /")
        expect(page.locator(".events .list")).to_contain_text("mark 1")  # a seek does not forget it
        page.get_by_role("link", name="Live").click()
        expect(page.locator(".lamp")).to_have_attribute("data-state", "fresh")
        page.goto(f"{url}?recording=no.mcap")
        expect(page.locator("#waiting")).to_contain_text("not a recording")
