"""Settings of the daemon itself, whatever craft it serves: what it writes and keeps, what it tells and takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from magcal_service.base.typed_toml.keys import number, special, whole
from magcal_service.config import rules


@dataclass(frozen=True, slots=True)
class OutputConfig:
    """What the daemon writes beside what it publishes.

    Parameters
    ----------
    csv: one row per tick into this file, relative to the working directory; None: no file.
    status_period_s: time between two status messages [s].
    links: addresses of links that take what is published as well.
    """

    csv: Path | None = special(rules.csv_file, None)
    status_period_s: float = number(10.0, 1.0, 3600.0, unit="s")
    links: tuple[str, ...] = special(rules.output_links, ())


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """Sessions recorded as MCAP files; needs the extra ``record``.

    Parameters
    ----------
    directory: where the files go, relative to the working directory; made where absent.
    flush_s: what was recorded is on the disk after this much time [s].
    file_mb: a file that has this size is ended and the next begun [MB].
    file_h: the same by age [h].
    total_mb: the oldest files are deleted beyond this size of them all [MB]; None: nothing is deleted.
    min_free_mb: recording stops where the disk has less room than this left for others [MB].
    retry_s: time between two attempts to record again [s].
    """

    directory: Path = special(rules.recordings_directory)
    flush_s: float = number(5.0, 0.1, 60.0, unit="s")
    file_mb: float = number(64.0, 0.01, 4096.0, unit="MB")
    file_h: float = number(6.0, 0.001, 720.0, unit="h")
    total_mb: float | None = number(None, 0.02, 1e7, unit="MB", check=rules.check_total)
    min_free_mb: float = number(64.0, 0.0, 1e6, unit="MB")
    retry_s: float = number(60.0, 0.1, 3600.0, unit="s")


@dataclass(frozen=True, slots=True)
class StateConfig:
    """Checkpoints: the whole state of each craft on disk, taken up again by a restarted daemon.

    Parameters
    ----------
    directory: where they go, a folder for each craft, relative to the working directory; made where absent.
    period_s: time between two checkpoints of a craft [s]; its least value bounds the wear on flash.
    keep: checkpoints of a craft that are kept, so that a damaged one has another before it.
    key: file of the key that they are signed with; None: a checksum alone, which notices damage and no forgery.
    counters: folder outside ``directory`` where the number of a craft's newest checkpoint but one is kept, so that an
        older one is not taken up again; None: any signed one is.
    """

    directory: Path = special(rules.checkpoints_directory)
    period_s: float = number(60.0, 10.0, 86_400.0, unit="s")
    keep: int = whole(3, 2, 100, unit="files")
    key: Path | None = special(rules.checkpoints_key, None)
    counters: Path | None = special(rules.checkpoints_counters, None)


@dataclass(frozen=True, slots=True)
class HealthConfig:
    """What the daemon reports about itself beside its status.

    Parameters
    ----------
    metrics: loopback address and port of the Prometheus text; None: not served.
    summary_s: time between two summaries in the log [s].
    """

    metrics: str | None = special(rules.metrics_address, None)
    summary_s: float = number(300.0, 1.0, 86_400.0, unit="s")


@dataclass(frozen=True, slots=True)
class CommandsConfig:
    """How many commands each craft takes, of all sources together.

    Parameters
    ----------
    rate_per_min: commands a minute in the long run [1/min].
    burst: commands at once, after a pause.
    """

    rate_per_min: float = number(60.0, 1.0, 6000.0, unit="1/min")
    burst: int = whole(20, 1, 1000, unit="commands")
