"""Families of figures as Prometheus text; ``metrics_server`` serves it.

Format: Prometheus text exposition format 0.0.4.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

Labels = Mapping[str, str]
Sample = tuple[str, Labels, float]


class Metrics:
    """Collects families of samples and renders them."""

    def __init__(self) -> None:
        self._lines: list[str] = []

    def add(self, name: str, kind: str, text: str, samples: Iterable[tuple[Labels, float]]) -> None:
        """One family.

        Parameters
        ----------
        name: without the prefix ``magcal_``.
        kind: ``counter`` or ``gauge``.
        text: what it counts.
        samples: labels and value of each.
        """
        self._head(name, kind, text)
        self._lines += [_sample(f"magcal_{name}", labels, value) for labels, value in samples]

    def add_histogram(self, name: str, text: str, bounds: Iterable[float], counts: list[int], total: float) -> None:
        """A histogram: counts by bucket, the last one beyond the last bound, and the sum of all values."""
        self._head(name, "histogram", text)
        reached = 0
        for bound, count in zip(bounds, counts, strict=False):
            reached += count
            self._lines.append(_sample(f"magcal_{name}_bucket", {"le": repr(bound)}, reached))
        self._lines.append(_sample(f"magcal_{name}_bucket", {"le": "+Inf"}, sum(counts)))
        self._lines.append(_sample(f"magcal_{name}_sum", {}, total))
        self._lines.append(_sample(f"magcal_{name}_count", {}, sum(counts)))

    def _head(self, name: str, kind: str, text: str) -> None:
        self._lines += [f"# HELP magcal_{name} {text}", f"# TYPE magcal_{name} {kind}"]

    def render(self) -> str:
        """The whole text."""
        return "\n".join(self._lines) + "\n"


def _sample(name: str, labels: Labels, value: float) -> str:
    inner = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
    number = repr(float(value)) if isinstance(value, float) else str(value)
    return f"{name}{{{inner}}} {number}" if inner else f"{name} {number}"


def _escaped(label: str) -> str:
    return label.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
