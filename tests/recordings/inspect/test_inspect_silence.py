"""Nothing is found on a log without a defect."""

from pathlib import Path

import pytest

from tests.recordings.inspect.clean_logs import clean_log, kind_of


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_found_on_a_clean_log(seed: int, tmp_path: Path) -> None:
    inspection = clean_log(kind_of(seed), seed).inspected(tmp_path)
    assert [str(one) for one in inspection.findings] == []
    assert inspection.usable is inspection.recording
