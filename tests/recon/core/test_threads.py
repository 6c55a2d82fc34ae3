"""Rows shared out to threads."""

import pytest
from uncle.recon.core.threads import share_out


@pytest.mark.parametrize("count", [0, 1, 2, 7, 100])
def test_every_row_is_worked_on_once(threads, count):
    done: list[slice] = []
    share_out(done.append, count)
    assert sorted(row for rows in done for row in range(count)[rows]) == list(range(count))
    assert len(done) == max(1, min(threads, count))


def test_what_fails_in_a_thread_fails(threads):
    def fail(rows: slice) -> None:
        raise MemoryError

    with pytest.raises(MemoryError):
        share_out(fail, 10)
