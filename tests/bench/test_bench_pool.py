"""Worker processes of benches."""

from bench.pool import workers


def test_workers_give_results_in_order() -> None:
    with workers() as pool:
        assert list(pool.map(abs, [-1, 2])) == [1, 2]
