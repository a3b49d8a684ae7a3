"""The rows of a study as they must be wherever it was carried out: without what tells of the time and the place."""

from calibench.bench.store.runs import ResultStore

OF_THE_PLACE = ["study", "wall_s", "cpu_s", "git_commit", "git_dirty", "versions", "platform", "started_at"]


def rows(folder):
    """Return the runs of the study in `folder`, or of a store, without those columns."""
    store = folder if isinstance(folder, ResultStore) else ResultStore(folder)
    return store.runs().drop(columns=OF_THE_PLACE)
