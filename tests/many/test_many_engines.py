"""Every engine: the same bits, the order of the jobs, a killed worker, refusals and defects."""

from __future__ import annotations

import ast
import multiprocessing
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magcal_service.base.errors import ConfigError, ExtraMissingError
from magcal_service.many.cluster import Cluster
from magcal_service.many.executor import (
    Executor,
    PieceRefusedError,
    PiecesFailedError,
    engine_for,
)
from magcal_service.many.pieces import ATTEMPTS, Done, Failed, Piece, Refused
from magcal_service.many.pool import WORKER, Pool
from tests.many import work
from tests.many.here import HERE

SEEDS = np.random.SeedSequence(7).spawn(5)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """HOST:PORT of a dask scheduler with two workers, processes of this machine."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        processes=True,
        scheduler_kwargs={"dashboard": False},
    ) as cluster:
        yield cluster.scheduler_address.removeprefix("tcp://")


@pytest.fixture(scope="module")
def expected() -> list[bytes]:
    """Solutions by a process with one thread, one after the other."""
    code = "from tests.many.test_many_engines import SEEDS; from tests.many.work import solved\n"
    code += "print([solved(seed) for seed in SEEDS])"
    one_thread = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=one_thread, capture_output=True, text=True, check=True)
    return list(ast.literal_eval(done.stdout))


@pytest.fixture(params=["one", "two", "dask"])
def executor(request: pytest.FixtureRequest) -> Executor:
    """Each engine in turn."""
    if request.param == "dask":
        return Executor(Cluster(request.getfixturevalue("scheduler")))
    return Executor(Pool({"one": 1, "two": 2}[request.param]))


def test_every_engine_gives_the_same_bits_in_the_order_of_the_jobs(executor: Executor, expected: list[bytes]) -> None:
    assert list(executor.map(work.solved, SEEDS)) == expected


def test_refusals_and_defects_are_outcomes_and_cost_no_other_piece(executor: Executor) -> None:
    pieces = [Piece(f"p{value}", work.divided, value) for value in (4, 0, -1, 2)]
    quarter, defect, refusal, half = executor.outcomes("quotients", pieces)
    assert (quarter, half) == (Done(0.25), Done(0.5))
    assert isinstance(defect, Failed)
    assert defect.text == "ZeroDivisionError: float division by zero"
    assert "work.py" in defect.trace
    assert refusal == Refused("value: -1 is refused; 0 or more is accepted", 2)


def test_nothing_to_do_is_done(executor: Executor) -> None:
    assert list(executor.map(work.squared, [])) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_worker_costs_its_piece_alone_which_is_begun_again(workers: int, tmp_path: Path) -> None:
    log = tmp_path / "log"
    jobs = [(log, value) for value in range(4)]
    assert list(Executor(Pool(workers)).map(work.killed_once, jobs)) == [100, 101, 102, 103]
    assert sorted(log.read_text().split()) == ["0", "1", "1", "2", "3"]


def test_a_piece_that_kills_its_worker_each_time_fails_by_name_and_the_others_are_done(tmp_path: Path) -> None:
    log = tmp_path / "log"
    with pytest.raises(PiecesFailedError, match=r"^runs, 1: failed: its process died 3 times, .* signal 9") as error:
        list(Executor(Pool(2)).map(work.killed_always, [(log, value) for value in range(4)], "runs"))
    assert error.value.exit_code == 1
    assert sorted(log.read_text().split()) == ["0", *["1"] * ATTEMPTS, "2", "3"]


def test_a_worker_of_the_cluster_that_is_killed_costs_its_piece_alone(scheduler: str, tmp_path: Path) -> None:
    log = tmp_path / "log"
    jobs = [(log, value) for value in range(4)]
    assert list(Executor(Cluster(scheduler)).map(work.killed_once, jobs)) == [100, 101, 102, 103]
    assert sorted(log.read_text().split()) == ["0", "1", "1", "2", "3"]


def test_a_workers_linear_algebra_has_one_thread_and_this_process_keeps_its_own(monkeypatch: Any) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "7")
    assert list(Executor(Pool(1)).map(work.threads, [0])) == ["1"]
    assert os.environ["OPENBLAS_NUM_THREADS"] == "7"


def test_a_result_that_cannot_be_pickled_is_a_defect_by_name() -> None:
    (outcome,) = Executor(Pool(1)).outcomes("odd", [Piece("odd", work.not_to_be_pickled, 0)])
    assert isinstance(outcome, Failed)
    assert "pickle" in outcome.text


def test_a_refusal_ends_a_map_at_once_with_its_text_and_exit_code() -> None:
    with pytest.raises(PieceRefusedError, match=r"^value: -1 is refused") as error:
        list(HERE.map(work.divided, [-1, 0]))
    assert error.value.exit_code == 2


def test_no_process_outlives_its_results() -> None:
    """Of the pool's own: the cluster beside it may be starting a worker anew at any time."""

    def workers() -> int:
        return sum(child.name == WORKER for child in multiprocessing.active_children())

    results = Executor(Pool(2)).map(work.squared, [1, 2, 3])
    assert workers() == 0
    assert next(results) == 1
    assert workers() == 2
    results.close()
    assert workers() == 0


@pytest.mark.parametrize(
    ("given", "workers", "engine"),
    [
        ("pool", None, Pool),
        ("pool", 3, Pool),
        ("dask://10.0.0.7:1", None, Cluster),
        ("dask://[::1]:1", None, Cluster),
    ],
)
def test_the_engine_is_the_one_asked_for(given: str, workers: int | None, engine: type) -> None:
    assert type(engine_for(given, workers)) is engine


@pytest.mark.parametrize(
    "given", ["", "pools", "dask://", "dask://host", "dask://host:0", "dask://host:65536", "dask://a b:1", "tcp://h:1"]
)
def test_an_executor_that_is_none_is_refused_with_what_is_accepted(given: str) -> None:
    with pytest.raises(ConfigError, match=r"--executor: '.*' is refused; pool .* dask://HOST:PORT is accepted, such"):
        engine_for(given)


@pytest.mark.parametrize(("given", "workers"), [("pool", 0), ("pool", -1), ("dask://host:1", 2)])
def test_workers_that_make_no_sense_are_refused(given: str, workers: int) -> None:
    with pytest.raises(ConfigError, match="--workers"):
        engine_for(given, workers)


def test_a_cluster_without_dask_names_the_extra(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExtraMissingError, match=r"'distributed'; install it with: pip install .*\[cluster\]"):
        list(Executor(Cluster("127.0.0.1:1")).map(work.squared, [1]))


def test_a_scheduler_that_does_not_answer_is_refused_with_how_to_start_one() -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ConfigError, match=r"--executor: 'dask://127.0.0.1:9' is refused; .*: dask scheduler --host"):
        list(Executor(Cluster("127.0.0.1:9", answer_s=0.3)).map(work.squared, [1]))


def test_a_function_of_a_script_is_found_by_its_workers_and_its_code_counts(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    source = f"""
import sys
sys.path.insert(0, {str(Path(__file__).resolve().parents[2])!r})
from magcal_service.many.executor import Executor
from magcal_service.many.identity import code_of
from magcal_service.many.pool import Pool

def twice(value):
    return FACTOR * value

if __name__ == "__main__":
    print(*Executor(Pool(1)).map(twice, [1, 2]), code_of(twice))
"""
    told = []
    for factor in (2, 3):
        script.write_text(f"FACTOR = {factor}\n{source}", encoding="utf-8")
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
        told.append(done.stdout.split())
    assert [words[:2] for words in told] == [["2", "4"], ["3", "6"]]
    assert told[0][2] != told[1][2]
