"""What is said of slips while a scene is played: each when it is gross, and when it has ended."""

from tactiled.emulator.scene.description import load_scene
from tactiled.emulator.scene.slip_instants import SlipEpisode, SlipEpisodeTracker
from tactiled.emulator.scene.truth import Truth
from tactiled.emulator.shell import SlipReports


def test_each_slip_is_news_when_gross_and_when_ended_and_never_again() -> None:
    watch = SlipEpisodeTracker()
    news = SlipReports(watch)

    def said() -> list[tuple[int, bool, bool]]:
        truth = Truth(load_scene("flat-simulation").with_changes(contact="lumped"), 100.0)
        truth.contact.watch.episodes = watch.episodes  # type: ignore[attr-defined]
        slips = news.since_last(lambda: truth)
        return [(s["number"], s["gross_s"] is not None, s["end_s"] is not None) for s in slips]

    assert said() == []
    watch.episodes, watch.count = [SlipEpisode(1.0, 1.1)], 1
    assert said() == []  # incipient
    watch.episodes[0].gross_s = 1.2
    assert said() == [(0, True, False)]
    assert said() == []
    watch.episodes[0].end_s = 2.0
    watch.episodes = [*watch.episodes, SlipEpisode(3.0, 3.1, end_s=3.2), SlipEpisode(4.0, 4.1, 4.2)]
    watch.count = 3
    assert said() == [(0, True, True), (1, False, True), (2, True, False)]
    watch.episodes = watch.episodes[2:]  # the oldest are forgotten
    watch.episodes[0].end_s = 5.0
    assert said() == [(2, True, True)]
