"""Reports of slips while a scene is played: each when it is gross, and when it has ended."""

from tactiled.emulator.realtime import SlipReports
from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.physical import PhysicalContact
from tactiled.emulator.scene.slip_instants import SlipEpisode, SlipEpisodeTracker
from tactiled.emulator.scene.truth import Truth


def test_each_slip_is_reported_when_gross_and_when_ended_once() -> None:
    tracker = SlipEpisodeTracker()
    reports = SlipReports(tracker)

    def new_reports() -> list[tuple[int, bool, bool]]:
        truth = Truth(load_scene("flat-simulation").with_changes(contact="lumped"), 100.0)
        assert isinstance(truth.contact, PhysicalContact)
        truth.contact.watch.episodes = tracker.episodes
        slips = reports.since_last(lambda: truth)
        return [(s["number"], s["gross_s"] is not None, s["end_s"] is not None) for s in slips]

    assert new_reports() == []
    tracker.episodes, tracker.count = [SlipEpisode(1.0, 1.1)], 1
    assert new_reports() == []  # incipient
    tracker.episodes[0].gross_s = 1.2
    assert new_reports() == [(0, True, False)]
    assert new_reports() == []
    tracker.episodes[0].end_s = 2.0
    tracker.episodes = [*tracker.episodes, SlipEpisode(3.0, 3.1, end_s=3.2), SlipEpisode(4.0, 4.1, 4.2)]
    tracker.count = 3
    assert new_reports() == [(0, True, True), (1, False, True), (2, True, False)]
    tracker.episodes = tracker.episodes[2:]  # the oldest are forgotten
    tracker.episodes[0].end_s = 5.0
    assert new_reports() == [(2, True, True)]
