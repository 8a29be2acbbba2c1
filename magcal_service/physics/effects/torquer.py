"""Magnetic torquers: field of the driven coil, its decay, and the remanence of the core."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from magcal_service.model import Array
from magcal_service.physics.acting import ActsOn, Watched
from magcal_service.physics.columns import Columns, along_axes
from magcal_service.physics.drivers.proportion import apart_in, named
from magcal_service.physics.drivers.pulses import pulses
from magcal_service.physics.drivers.torquing import DETUMBLING, DUMPING, inferred
from magcal_service.physics.held import Form, HeldAt, at_zero_of
from magcal_service.physics.interface import Block, Effect, Hypothesis, Nonlinear, Values
from magcal_service.physics.saying import AXES
from magcal_service.physics.scene.scene import Scene
from magcal_service.physics.scene.sunlight import carried

DECAYS_S: Final = np.array([0.0, 0.1, 0.3, 1.0, 3.0])
"""L/R of the coil, 0: faster than a sample."""


_MANY: Final = 2000
"""Samples from which on the recursion is worked out in whole columns: no block of a live stream is so long."""


def _decayed(scene: Scene, moment: Array, decay_s: float) -> Array:
    """The current's response (n, k) to a held command: a first-order lag from each sample's command to the next."""
    if decay_s <= 0.0:
        return moment
    kept = np.exp(-np.diff(scene.time_s) / decay_s)
    answer = np.array(moment, dtype=np.float64)
    answer[0] = scene.begin("current", answer[0])
    if len(moment) > _MANY:
        answer[1:] = carried(kept, (1.0 - kept)[:, None] * moment[1:], answer[0])
    else:  # live, sample by sample, to the same bits however the samples come
        for row in range(1, len(moment)):
            answer[row] = moment[row] + kept[row - 1] * (answer[row - 1] - moment[row])
    scene.keep("current", answer)
    return answer


def remembered(scene: Scene, moment: Array, largest: float) -> Array:
    """Sign of the last command that was not zero (n, k), 0 before the first."""
    signs = np.sign(np.where(np.abs(moment) > 0.02 * largest, moment, 0.0))
    signs[0] = np.where(signs[0] == 0.0, scene.begin("sign", 0.0), signs[0])
    rows = np.where(signs != 0.0, np.arange(len(signs))[:, None], -1)
    last = np.maximum.accumulate(rows, axis=0)
    found = np.where(last >= 0, np.take_along_axis(signs, np.maximum(last, 0), axis=0), 0.0)
    scene.keep("sign", found)
    return found


def _of_the_row_before(scene: Scene, moment: Array) -> Array:
    """Commands (n, k) that act from their row on: a row's own is written down when it is given, after the sample.

    Of a stream's scene the first row is the last one of the scene before it, whose channels are held since.
    """
    before = np.concatenate([moment[:1], moment[:-1]])
    before[:2] = scene.begin("command", before[:2])
    scene.keep("command", moment)
    return before


def _driven(scene: Scene, moment: Array, largest: float | None, is_after: bool) -> Callable[[Array], Columns]:
    def columns(theta: Array) -> Columns:
        acting = _of_the_row_before(scene, moment) if is_after else moment
        signals = _decayed(scene, acting, float(theta[0]))
        if largest is not None:
            signals = np.concatenate([signals, remembered(scene, acting, largest)], axis=1)
        return along_axes(signals)

    return columns


def _hypotheses(scene: Scene) -> Iterator[Hypothesis]:
    decay = Nonlinear("decay_s", "s", DECAYS_S, spans=True)
    for channel in scene.of_quantity("magnetic moment"):
        own = apart_in(scene, channel)
        used = [column for column in scene.chosen("column", list(own)) if column < channel.values.shape[1]]
        if not used:
            continue
        moment, count = channel.values[:, used], len(used)
        coils = tuple(named(f"coil {c + 1}", [f"coil {other + 1}" for other in own.get(c, ())]) for c in used)
        matrix = Block("nt_per_am2", "nT/(A m2)", (count, 3), labels=(coils, AXES))
        largest = scene.constant("largest_am2", float(np.abs(moment).max()))
        constants = {f"column_{index}": float(column) for index, column in enumerate(used)}
        driver = f"channel:{channel.name}"
        with_largest = constants | {"largest_am2": largest}
        remanence = Block("remanence_nt", "nT", (count, 3), labels=(coils, AXES))
        for is_after, when in ((False, ""), (True, "commands after their rows")):
            act = _driven(scene, moment, None, is_after)
            plain = Hypothesis("torquer", driver, act, (matrix,), when, (decay,), constants)
            yield plain
            yield replace(
                plain,
                columns=_driven(scene, moment, largest, is_after),
                blocks=(matrix, remanence),
                variant=", ".join(filter(None, (when, "with remanence"))),
                constants=with_largest,
            )
    yield from inferred(scene, "torquer", as_well=("current_loop",))  # a heater or a beacon on a duty


def _derived(parameters: Values) -> Values:
    """M with the field's axis as the row and the coil as the column, d = M m; fitted the other way round."""
    found = parameters.get("nt_per_am2")
    if found is None:
        return {}
    turned = replace(found, value=found.value.T, sigma=found.sigma.T, labels=found.labels[::-1])
    return {"nt_per_am2": turned}


def _held_at(form: Form) -> HeldAt:
    """Coils without a current, and cores without a remanence where that was fitted."""
    if not form.driver.startswith("channel:"):
        return HeldAt(form.driver, 0.0, "1", "torquers that are off")
    found = at_zero_of(form, "A m2")
    if "remanence_nt" not in form.block_names:
        return found
    return replace(found, says=f"{found.says}, its cores without remanence")


EFFECT = Effect(
    name="torquer",
    acts_on=ActsOn.FIELD,
    not_live=(DETUMBLING, DUMPING),
    watched=((Watched.BIAS_BY, "magnetic moment"),),
    title="magnetic torquers",
    switched="the torquers",
    two_levels=True,
    equation="d = M m(t), m with the coil's decay L/R, and a remanence that keeps the sign of the last command",
    units={
        "nt_per_am2": "nT/(A m2)",
        "remanence_nt": "nT",
        "on_nt": "nT",
        "detumbling_nt": "nT",
        "dumping": "1",
        "decay_s": "s",
        "period_s": "s",
        "on_share": "1",
        "phase": "1",
        "hold_s": "s",
        "lead_s": "s",
        "middle_s": "s",
        "from_s": "s",
        "to_s": "s",
        "pulse_nt": "nT",
    },
    prior=(10.0, 50000.0),
    valid="commands held between samples, up to their row or from it on; no saturation of the core",
    confused_with=("tone", "bias_step", "current_loop"),
    separated_by="a torquer test: one coil switched by hand while nothing else changes",
    source="0.2 A m2 at 10 cm gives 20-40 uT (dipole field); Olsen et al. 2020 (CryoSat-2 torquers)",
    says=(
        "The torquers make up to {nt_per_am2.size} ({nt_per_am2.place}), with {driver}.",
        "Torquers on a regular duty of {period_s.size} make up to {on_nt.size} on {on_nt.place} while on.",
        "Torquers that detumble by the sign of dB/dt make up to {detumbling_nt.size} ({detumbling_nt.place}).",
        "Torquers that dump momentum every {period_s.size} add {dumping.percent} of the field.",
        "Torquers that are not recorded fire every {period_s.size}, for {on_share.percent} of it, each time with "
        "another field, of {pulse_nt.size} by rms; the rows within these pulses are left out.",
    ),
    find=lambda view: pulses(view, as_well=("current_loop",)),  # a wheel's motor, a battery: of both signs
    derived=_derived,
    held_at=_held_at,
    hypotheses=lambda scene: tuple(_hypotheses(scene)),
)
