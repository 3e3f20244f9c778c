"""Predictions against where their own tracks were later seen: a measure that needs no ground truth.

One pass over frames and predictions: a prediction waits until its last step has passed, is scored
against the track positions since, and is forgotten; so are positions that no waiting prediction
needs. What is kept spans one horizon, however long the log.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.blocks import block_keys
from adcbf_cli.core.evaluation.forecasts import ForecastScore, Reference, target_stamps
from adcbf_cli.core.evaluation.lives import reported
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.paths import EDGE_TOLERANCE_NS, Paths
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray, Predictions, Tracks

ALL = Reference("later_seen", "later seen", {})
MOVING = Reference("later_seen.moving", "later seen", {})
SCORED_TOGETHER = 8
"""So many predictions are scored against the same index of positions, which costs as much as one's scoring."""


class LaterSeen:
    """Feed it each frame's tracks and predictions in the order of time, then `finish`."""

    def __init__(self, config: EvaluationConfig) -> None:
        self._all = ForecastScore(ALL, config.horizons_s, own_ids=True)
        self._moving = ForecastScore(MOVING, config.horizons_s, own_ids=True)
        self._block_ns = round(config.bootstrap_block_s * 1e9)
        self._max_gap_ns = round(config.max_gap_s * 1e9)
        self._seen: deque[tuple[int, IntArray, FloatArray]] = deque()
        self._waiting: deque[Predictions] = deque()

    def see(self, tracks: Tracks) -> None:
        """One frame's tracks: those that are reported and have a cluster were seen where they are."""
        seen = reported(tracks) & (tracks.cluster_id != NO_ID)
        self._seen.append((tracks.stamp_ns, tracks.track_id[seen], tracks.state[seen, :2]))
        due = 0
        for record in self._waiting:
            if self._known_from(record) >= tracks.stamp_ns:
                break
            due += 1
        if due >= SCORED_TOGETHER:
            self._score(due)
        self._forget(tracks.stamp_ns)

    def predict(self, record: Predictions) -> None:
        """Predictions that were made at some frame's stamp, no earlier than the ones before."""
        self._waiting.append(record)

    def finish(self) -> None:
        """Scores what still waits: nothing more will be seen."""
        self._score(len(self._waiting))
        self._seen.clear()

    def metrics(self) -> dict[str, Metric]:
        return self._all.metrics() | self._moving.metrics()

    def _known_from(self, record: Predictions) -> int:
        """After this stamp nothing that comes can tell more of where the tracks were at the record's targets."""
        return int(target_stamps(record)[-1]) + self._max_gap_ns + EDGE_TOLERANCE_NS

    def _forget(self, now_ns: int) -> None:
        """Drops the positions that lie a gap or more before all targets to come."""
        oldest_ns = self._waiting[0].stamp_ns if self._waiting else now_ns
        while self._seen and self._seen[0][0] < oldest_ns - self._max_gap_ns - EDGE_TOLERANCE_NS:
            self._seen.popleft()

    def _score(self, count: int) -> None:
        """Scores the oldest `count` records."""
        if not count:
            return
        stamps = np.repeat([stamp for stamp, _, _ in self._seen], [len(ids) for _, ids, _ in self._seen])
        ids = np.concatenate([np.zeros(0, dtype=np.int64), *(ids for _, ids, _ in self._seen)])
        places = np.concatenate([np.zeros((0, 2)), *(places for _, _, places in self._seen)])
        paths = Paths(ids, stamps.astype(np.int64), places, self._max_gap_ns)
        for _ in range(count):
            self._score_one(self._waiting.popleft(), paths)

    def _score_one(self, record: Predictions, paths: Paths) -> None:
        target_ns = target_stamps(record)
        n, steps = len(record), len(target_ns)
        later, _ = paths.at(np.repeat(record.track_id, steps), np.tile(target_ns, n))
        error = record.position_m[..., :2] - later.reshape(n, steps, 2)
        blocks = block_keys(record.track_id, np.full(n, record.stamp_ns, dtype=np.int64), self._block_ns)
        moving = np.flatnonzero(~record.is_static)
        self._all.add(record, np.arange(n), blocks, error, {})
        self._moving.add(record, moving, blocks[moving], error[moving], {})
