"""What a planner may know at a moment: what the log's tracker had seen and predicted by then.

The newest predictions at or before now, carried on to now. The tracker saw from the log's vehicle: an
ego that has left its side knows what was seen from there, no more and no less (`Drive.log_m`). What
stood when it was last seen is taken to stand there still, as on a map, until something else is seen at
its place or the log's vehicle drives over it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray, Notes, Predictions

STALE_NS = 500_000_000
"""Predictions older than this are still carried on, and each use of them is counted."""

Uncertainty = Literal["none", "sigma", "conformal"]


@dataclass(frozen=True, slots=True)
class _Seen:
    """n tracks of one record: nodes at its stamp and its steps, M + 1 in all.

    z_m: (n,) height of the centre. node_m: (n, M + 1, 2), the first extrapolated back from step 1.
    velocity_mps: (n, M + 1, 2). sigma_m, conformal_m: (n, M + 1) margins, the first as at step 1.
    """

    stamp_ns: int
    step_s: float
    track_id: IntArray
    is_static: BoolArray
    radius_m: FloatArray
    z_m: FloatArray
    node_m: FloatArray
    velocity_mps: FloatArray
    sigma_m: FloatArray
    conformal_m: FloatArray

    def where(self, keep: BoolArray) -> _Seen:
        per_track = (getattr(self, name)[keep] for name in _Seen.__slots__[2:])
        return _Seen(self.stamp_ns, self.step_s, *per_track)


@dataclass(frozen=True, slots=True)
class _Standing:
    """What stood when it was last seen: centre (2,), its height, and margins as at the record's first step."""

    centre_m: FloatArray
    radius_m: float
    z_m: float
    sigma_m: float
    conformal_m: float


class Knowledge:
    """Takes `Predictions` records in order of time; answers for any time from the newest one on."""

    def __init__(self, notes: Notes, body_radius_m: float = 0.0) -> None:
        """body_radius_m: of the log's vehicle; what is seen within it is the vehicle itself."""
        self._notes = notes
        self._body_radius_m = body_radius_m
        self._seen: _Seen | None = None
        self._standing: dict[int, _Standing] = {}
        self._ended = False
        self._at: tuple[tuple[int, int, float, Uncertainty], Obstacles] | None = None

    @property
    def stamp_ns(self) -> int | None:
        """The newest record's; None before the first."""
        return None if self._seen is None else self._seen.stamp_ns

    def update(self, record: Predictions, vehicle_m: FloatArray | None = None) -> None:
        """One more record. vehicle_m: (2,) where the log's vehicle was then, NaN or None where not known.

        AdcbfError where a number that is needed is not finite, or the record is older than the last.
        """
        _check(record, self.stamp_ns)
        seen = _nodes(record)
        if vehicle_m is not None and np.isfinite(vehicle_m).all():
            own = np.hypot(*(seen.node_m[:, 0] - vehicle_m).T) < self._body_radius_m
            self._notes.count("tracks_within_own_body", int(own.sum()))
            seen = seen.where(~own)
            self._forget(vehicle_m[None], np.array([self._body_radius_m]))
        if self._seen is not None:
            self._remember(self._seen.where(self._seen.is_static & ~np.isin(self._seen.track_id, seen.track_id)))
        for track_id in seen.track_id.tolist():
            self._standing.pop(track_id, None)
        self._forget(seen.node_m[:, 0], seen.radius_m)
        self._seen = seen
        self._at = None

    def standing(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """What is remembered to stand and not seen now: ids (k,), centres (k, 3), radii (k,)."""
        items = self._standing.values()
        centre = np.array([[*item.centre_m, item.z_m] for item in items]).reshape(-1, 3)
        return np.array(list(self._standing), dtype=np.int64), centre, np.array([item.radius_m for item in items])

    def forget(self, track_ids: IntArray) -> None:
        """These are remembered no longer: their places were seen to be free."""
        for track_id in track_ids.tolist():
            del self._standing[track_id]
        self._at = None

    def end(self) -> None:
        """The recording is over: from now on only what stands is known."""
        if not self._ended and self._seen is not None:
            self._seen = self._seen.where(self._seen.is_static)
            self._at = None
        self._ended = True

    def obstacles(
        self, stamp_ns: int, ego_m: FloatArray, range_m: float, steps: int, step_s: float, uncertainty: Uncertainty
    ) -> Obstacles:
        """Obstacles whose surface, now, is within `range_m` of the ego's place (2,), over `steps` steps.

        Where the ego is nothing else is: what is believed to be centred in its body is not told, and circles
        that reach into it are trimmed to leave it free.
        Positions are interpolated between the record's steps, and go on with the last one's velocity
        after them. Margins are the record's, interpolated, and go on growing as they last did; where
        the conformal one is missing, sigma's is taken, and counted.
        """
        everything = self._all(stamp_ns, steps, step_s, uncertainty)
        if not len(everything):
            return everything
        distance_m = np.hypot(*(everything.position_m[:, 0] - ego_m).T)
        told = (distance_m - everything.radius_m <= range_m) & (distance_m > self._body_radius_m)
        near = Obstacles(*(getattr(everything, name)[told] for name in Obstacles.__slots__))
        return replace(near, radius_m=np.minimum(near.radius_m, distance_m[told] - self._body_radius_m))

    def _all(self, stamp_ns: int, steps: int, step_s: float, uncertainty: Uncertainty) -> Obstacles:
        if self._seen is not None and not self._ended and stamp_ns - self._seen.stamp_ns > STALE_NS:
            self._notes.count("steps_on_stale_predictions")
        key = (stamp_ns, steps, step_s, uncertainty)
        if self._at is None or self._at[0] != key:
            self._at = (key, self._carried(stamp_ns, steps, step_s, uncertainty))
        return self._at[1]

    def _carried(self, stamp_ns: int, steps: int, step_s: float, uncertainty: Uncertainty) -> Obstacles:
        known = self._remembered(steps, uncertainty)
        if self._seen is None or not len(self._seen.track_id):
            return known
        seen = self._seen
        time_s = np.asarray((stamp_ns - seen.stamp_ns) / 1e9 + step_s * np.arange(steps + 1), dtype=np.float64)
        position, velocity = _positions(seen, time_s)
        now = Obstacles(
            track_id=seen.track_id,
            position_m=position,
            radius_m=seen.radius_m,
            margin_m=self._margins(seen, time_s, uncertainty),
            velocity_mps=velocity,
            is_static=seen.is_static,
        )
        return Obstacles(*(np.concatenate([getattr(now, n), getattr(known, n)]) for n in Obstacles.__slots__))

    def _margins(self, seen: _Seen, time_s: FloatArray, uncertainty: Uncertainty) -> FloatArray:
        if uncertainty == "none":
            return np.zeros((len(seen.track_id), len(time_s)))
        margin = seen.sigma_m
        if uncertainty == "conformal":
            missing = np.isnan(seen.conformal_m)
            self._notes.count("obstacles_without_conformal_radius", int(missing.any(axis=1).sum()))
            margin = np.where(missing, seen.sigma_m, seen.conformal_m)
        margin = np.where(seen.is_static[:, None], margin[:, :1], margin)  # what stands does not go astray
        node, share = _place(time_s, seen.step_s, margin.shape[1])
        growth = margin[:, node + 1] - margin[:, node]
        beyond = share > 1.0
        return np.asarray(margin[:, node] + share * np.where(beyond, np.maximum(growth, 0.0), growth))

    def _remembered(self, steps: int, uncertainty: Uncertainty) -> Obstacles:
        """What stood and is no longer seen."""
        n = len(self._standing)
        items = list(self._standing.values())
        place = np.array([item.centre_m for item in items]).reshape(n, 1, 2)
        margin = {
            "none": 0.0,
            "sigma": [item.sigma_m for item in items],
            "conformal": [item.conformal_m for item in items],
        }
        return Obstacles(
            track_id=np.array(list(self._standing), dtype=np.int64),
            position_m=np.repeat(place, steps + 1, axis=1),
            radius_m=np.array([item.radius_m for item in items]),
            margin_m=np.tile(np.broadcast_to(np.asarray(margin[uncertainty]), (n,))[:, None], (1, steps + 1)),
            velocity_mps=np.zeros((n, 2)),
            is_static=np.ones(n, dtype=np.bool_),
        )

    def _remember(self, gone: _Seen) -> None:
        """Keeps standing tracks that are seen no more, with the margin of the record's first step."""
        first_conformal = np.where(np.isnan(gone.conformal_m[:, 0]), gone.sigma_m[:, 0], gone.conformal_m[:, 0])
        for row, track_id in enumerate(gone.track_id.tolist()):
            self._standing[track_id] = _Standing(
                centre_m=gone.node_m[row, 0],
                radius_m=float(gone.radius_m[row]),
                z_m=float(gone.z_m[row]),
                sigma_m=float(gone.sigma_m[row, 0]),
                conformal_m=float(first_conformal[row]),
            )

    def _forget(self, centre_m: FloatArray, radius_m: FloatArray) -> None:
        """Drops what is remembered to stand where one of these circles (k, 2), (k,) is now."""
        if not self._standing or not len(centre_m):
            return
        ids = list(self._standing)
        offset = np.array([self._standing[i].centre_m for i in ids])[:, None] - centre_m
        covered = (np.hypot(offset[..., 0], offset[..., 1]) < radius_m).any(axis=1)
        for track_id in np.array(ids)[covered].tolist():
            del self._standing[track_id]


def _check(record: Predictions, last_ns: int | None) -> None:
    where = f"predictions, frame {record.frame_index} (stamp {record.stamp_ns} ns)"
    if last_ns is not None and record.stamp_ns < last_ns:
        raise AdcbfError(f"{where}: older than the record before it; run `adcbf predict` again")
    for name in ("position_m", "velocity_mps", "radius_m", "sigma_radius_m"):
        values = getattr(record, name)
        if not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise AdcbfError(
                f"{where}: {name} of track {int(record.track_id[row])} is not a number; run `adcbf predict` again"
            )


def _nodes(record: Predictions) -> _Seen:
    position, velocity = record.position_m[:, :, :2], record.velocity_mps
    return _Seen(
        stamp_ns=record.stamp_ns,
        step_s=record.step_s,
        track_id=np.asarray(record.track_id, dtype=np.int64),
        is_static=np.asarray(record.is_static, dtype=np.bool_),
        radius_m=record.radius_m,
        z_m=record.position_m[:, 0, 2],
        node_m=np.concatenate([position[:, :1] - velocity[:, :1] * record.step_s, position], axis=1),
        velocity_mps=np.concatenate([velocity[:, :1], velocity], axis=1),
        sigma_m=np.concatenate([record.sigma_radius_m[:, :1], record.sigma_radius_m], axis=1),
        conformal_m=np.concatenate([record.conformal_radius_m[:, :1], record.conformal_radius_m], axis=1),
    )


def _place(time_s: FloatArray, step_s: float, nodes: int) -> tuple[IntArray, FloatArray]:
    """The node before each time, never the last one, and how many steps the time is after it (k,)."""
    place = time_s / step_s
    node = np.clip(np.floor(place).astype(np.int64), 0, nodes - 2)
    return node, place - node


def _positions(seen: _Seen, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (n, k, 2) at times (k,) after the record's stamp, and velocities (n, 2) at the first."""
    node, share = _place(time_s, seen.step_s, seen.node_m.shape[1])
    leg = seen.node_m[:, node + 1] - seen.node_m[:, node]
    position = seen.node_m[:, node] + np.minimum(share, 1.0)[:, None] * leg
    beyond_s = np.maximum(share - 1.0, 0.0) * seen.step_s
    position = position + beyond_s[:, None] * seen.velocity_mps[:, -1:, :]
    first, part = int(node[0]), min(float(share[0]), 1.0)
    velocity = seen.velocity_mps[:, first] + part * (seen.velocity_mps[:, first + 1] - seen.velocity_mps[:, first])
    return position, velocity
