"""``./run bench recordings``: answers on public recordings of other groups."""
