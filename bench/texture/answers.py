"""Answers of the joint fit to a few windows, which tell whether a figure is older than the code."""

from bench.texture.trials import grid_trial

_WINDOW_S, _SNRS_DB, _SEEDS = 1.0, (0.0, 20.0), range(1000, 1006)  # choice: on other seeds than any result


def answers() -> dict[str, list[float]]:
    """Return errors of period and angle in standard deviations, and these in um and in millidegrees."""
    found = {}
    for snr_db in _SNRS_DB:
        for is_speed_known in (True, False):
            trials = [grid_trial(_WINDOW_S, snr_db, is_speed_known, seed) for seed in _SEEDS]
            estimates = [
                one for trial in trials if trial.status == "ok" for one in (trial.period, trial.angle)
            ]
            name = f"{snr_db:g} dB, speed {'known' if is_speed_known else 'unknown'}"
            found[name] = [
                round(value, 9) for one in estimates for value in (one.error / one.sd, 1e3 * one.sd)
            ]
    return found
