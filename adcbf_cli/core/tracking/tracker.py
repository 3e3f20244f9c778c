"""From the clusters of each frame to tracks: predict, associate, update, begin, confirm, end.

A track begins with a cluster that no track claims (tentative), is confirmed by enough hits, coasts
on its motion model while unseen, and ends when unseen for too long. Time for which something nearer hides it
counts apart: who walks behind a car has not gone. The ego's motion enters in the
measurement: states live in the world, and are seen from the sensor's pose of each frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.timing import Timer, no_timer
from adcbf_cli.core.tracking.association import assign
from adcbf_cli.core.tracking.bank import TrackBank, adapted_noise
from adcbf_cli.core.tracking.bodies import Bodies, aged_variance
from adcbf_cli.core.tracking.filters import BatchFilter
from adcbf_cli.core.tracking.hiding import is_hidden
from adcbf_cli.core.tracking.linalg import inverted, quadratic_form, symmetrised
from adcbf_cli.core.tracking.measurement import noise_along_axes, nominal_variance
from adcbf_cli.core.tracking.modes import ModeChain, combine, mix, reweighed
from adcbf_cli.core.tracking.sharing import Sharing, come_apart, homes, part_company, share_clusters, stand_and_move
from adcbf_cli.core.tracking.standing import hold_faint, hold_structures
from adcbf_cli.core.tracking.stillness import Sightings, known_to_move, still
from adcbf_cli.core.tracking.structures import wall_pieces
from adcbf_cli.core.tracking.views import learn_sizes, size_doubt, view_bodies
from adcbf_cli.core.types import NO_ID, BoolArray, Clusters, FloatArray, IntArray, Notes, Tracks, TrackStatus

HIDDEN_FACTOR = 2.0
"""Times what an unseen track goes on for, that it goes on further while something nearer hides it. Not for a planar
laser, in whose logs this made one of two passing tracks keep the other's cluster."""


class Tracker:
    """Takes frames in order, returns each frame's tracks. One instance a log."""

    def __init__(self, config: TrackingConfig, notes: Notes, timer: Timer = no_timer) -> None:
        self._config = config
        self._notes = notes
        self._timer = timer
        self._chain = ModeChain.from_config(config)
        self._filters: dict[bool, BatchFilter] = {}
        self._bank: TrackBank | None = None
        self._start_ns = 0
        self._now_ns: int | None = None
        self._next_id = 0

    def __call__(self, clusters: Clusters) -> Tracks:
        """The tracks after this frame, those that end in it included.

        A frame that is not newer than the last one is not used: its tracks are the last frame's,
        unseen, at the last frame's stamp, and a warning is noted.
        """
        kalman = self._filter(clusters.planar)  # before the timer starts: it imports filterpy once
        with self._timer("track"):
            clusters = self._finite(clusters)
            if self._bank is None:
                self._bank = TrackBank.empty(len(self._chain.noise_factor), kalman.motion.dimension)
            bank = self._bank
            if self._now_ns is None:
                self._start_ns = self._now_ns = clusters.stamp_ns
            elif clusters.stamp_ns <= self._now_ns:
                return self._skipped(bank, clusters)
            dt = (clusters.stamp_ns - self._now_ns) / 1e9
            self._now_ns = clusters.stamp_ns
            if dt > self._config.max_coast_s and len(bank):
                self._notes.count("tracking_gaps")
                self._notes.warn(
                    f"gaps longer than tracking.max_coast_s ({self._config.max_coast_s:g} s) between frames "
                    "end every track"
                )
                bank.keep(np.zeros(len(bank), dtype=np.bool_))
            stood = bank.states.copy(), bank.covariances.copy()
            self._predict(bank, kalman, dt)
            taken = self._update(bank, kalman, clusters)
            held = hold_faint(bank, clusters, self._now_s, *stood)
            self._count_hidden(bank, clusters, dt)
            self._end_and_confirm(bank)
            if not taken.all():
                born = self._born(kalman, clusters, np.flatnonzero(~taken))
                born.track_id = self._next_id + np.arange(len(born), dtype=np.int64)
                self._next_id += len(born)
                bank.append(born)
            sensor_m = clusters.world_from_sensor[:2, 3]
            seen = bank.cluster_id != NO_ID
            seen[: len(held)] &= ~held
            bank.sightings.add(seen, self._now_s, bank.seen_at_m, sensor_m)
            # What is not seen, or fades, stays what it was: else its last sightings, the least certain, would decide.
            stands = still(bank.is_static, bank.sightings, self._now_s, bank.radius_m, self._config)
            bank.is_static = bank.is_structure | np.where(seen, stands, bank.is_static)
            tracks = self._record(bank, clusters)
            bank.keep(bank.status != TrackStatus.ENDED)
            return tracks

    @property
    def _now_s(self) -> float:
        """Seconds since the first frame."""
        assert self._now_ns is not None
        return (self._now_ns - self._start_ns) / 1e9

    def _filter(self, planar: bool) -> BatchFilter:
        if planar not in self._filters:
            self._filters[planar] = BatchFilter(self._config, planar, self._notes)
        return self._filters[planar]

    def _finite(self, clusters: Clusters) -> Clusters:
        """Without clusters whose centre or size is not a number."""
        values = np.column_stack([clusters.centre_m, clusters.centre_sensor_m, clusters.radius_m, clusters.height_m])
        good: BoolArray = np.all(np.isfinite(values), axis=1)
        if good.all():
            return clusters
        self._notes.count("clusters_without_finite_centre", int(np.count_nonzero(~good)))
        return select_clusters(clusters, good)

    def _skipped(self, bank: TrackBank, clusters: Clusters) -> Tracks:
        self._notes.count("frames_out_of_order")
        self._notes.warn("frames whose stamp is not later than the frame before were not used for tracking")
        bank.cluster_id = np.full(len(bank), NO_ID, dtype=np.int64)
        bank.nis = np.full(len(bank), np.nan)
        assert self._now_ns is not None
        return self._record(bank, replace(clusters, stamp_ns=self._now_ns))

    def _predict(self, bank: TrackBank, kalman: BatchFilter, dt: float) -> None:
        """Moves every track on by dt (s)."""
        bank.cluster_id = np.full(len(bank), NO_ID, dtype=np.int64)
        bank.nis = np.full(len(bank), np.nan)
        if not len(bank):
            return
        hold_structures(bank)
        n, m, d = bank.states.shape
        states, covariances, bank.modes = mix(bank.states, bank.covariances, bank.modes, self._chain.transition(dt))
        noise = self._chain.noise_factor[:, None, None] * kalman.motion.process_noise(dt)
        moved, spread = kalman.predict(
            states.reshape(n * m, d), covariances.reshape(n * m, d, d), dt, np.tile(noise, (n, 1, 1))
        )
        bank.states, bank.covariances = moved.reshape(n, m, d), spread.reshape(n, m, d, d)
        bank.bodies.yaw_variance = aged_variance(bank.bodies.yaw_variance, bank.is_static, dt)

    def _update(self, bank: TrackBank, kalman: BatchFilter, clusters: Clusters) -> BoolArray:
        """Assigns clusters to tracks and corrects these; returns (c,) which clusters were taken."""
        taken = np.zeros(len(clusters), dtype=np.bool_)
        if not len(bank):
            return taken
        state, covariance = combine(bank.states, bank.covariances, bank.modes)
        expected = kalman.expect(state, covariance, clusters.world_from_sensor)
        noise = self._noise(bank, kalman, np.arange(len(bank)), state, clusters.world_from_sensor)
        sharing = self._sharing(bank, state, covariance, clusters)
        views = view_bodies(bank.bodies, state[:, :2], bank.is_structure, clusters, sharing, self._config)
        every = kalman.measurement.observe(views.centre_sensor_m(clusters))
        total = symmetrised(expected.covariance + noise)
        rows, columns = self._associate(bank, kalman, clusters, expected.mean, total, every)
        taken[columns] = True
        bank.frames += 1
        missed = np.ones(len(bank), dtype=np.bool_)
        missed[rows] = False
        bank.misses = np.where(missed, bank.misses + 1, 0)
        hidden = missed & bank.is_static & sharing.pairs(len(clusters))[:, taken].any(axis=1)
        bank.seen_s[hidden] = self._now_s  # one with what moves past it, not gone
        if not len(rows):
            return taken
        age_s = self._now_s - bank.born_s[rows]
        apart = come_apart(state[rows, :2], bank.radius_m[rows], age_s, columns, clusters, ~taken)
        doubt = size_doubt(bank, views, clusters, rows, columns)
        noise = self._noise(bank, kalman, rows, state, clusters.world_from_sensor, *doubt)
        measured = every[rows, columns]
        self._correct(bank, kalman, rows, measured, noise, clusters.world_from_sensor)
        innovation = kalman.measurement.difference(measured, expected.mean[rows])
        total = symmetrised(expected.covariance[rows] + noise)
        bank.nis[rows] = np.maximum(quadratic_form(innovation, inverted(total)), 0.0)
        if self._config.adaptive_noise:
            bank.noise_scale[rows] = adapted_noise(bank.noise_scale[rows], bank.hits[rows], innovation, total, noise)
        is_piece, spread_m = wall_pieces(clusters, self._config.structure_length_m)
        bank.is_structure[rows], bank.spread_m[rows] = is_piece[columns], spread_m[columns]
        since_s = self._now_s - bank.seen_s[rows]
        moved = learn_sizes(bank, views, clusters, rows, columns, since_s, self._config)
        bank.states[rows, :, :2] += moved[:, None, :]
        bank.sightings.shift(rows, moved)
        bank.seen_at_m[rows] = views.centre_m(clusters, rows, columns) + moved
        bank.cluster_id[rows] = clusters.cluster_id[columns]
        bank.seen_s[rows] = self._now_s
        bank.hits[rows] += 1
        anew = apart & ~is_piece[columns]
        if anew.any():
            bank.restart(rows[anew], self._born(kalman, clusters, columns[anew]))
        return taken

    def _sharing(self, bank: TrackBank, state: FloatArray, covariance: FloatArray, clusters: Clusters) -> Sharing:
        """Which clusters hold several of the tracks, whose states (n, d), covariances (n, d, d), are expected."""
        visible_m = state[:, :2] + bank.bodies.seen_at_m - bank.seen_at_m
        followed = (bank.status != TrackStatus.TENTATIVE) & ~bank.is_structure
        margin_m = np.sqrt(self._config.sigma_range_m**2 + covariance[:, 0, 0] + covariance[:, 1, 1])
        home = homes(visible_m, followed, clusters, margin_m)
        is_moving = known_to_move(bank.sightings, self._now_s, bank.radius_m, self._config)
        unlike = stand_and_move(bank.is_static, is_moving)
        unlike |= part_company(home, state[:, 3:5], covariance[:, 3:5, 3:5], bank.radius_m, clusters)
        return share_clusters(home, visible_m, unlike)

    def _associate(
        self,
        bank: TrackBank,
        kalman: BatchFilter,
        clusters: Clusters,
        expected: FloatArray,
        total: FloatArray,
        measured: FloatArray,
    ) -> tuple[IntArray, IntArray]:
        """Tracks that were confirmed choose first; tentative ones share what is left.

        expected: (n, k); measured: (n, c, k), each cluster as the measurement of each track's body.
        """
        tentative = bank.status == TrackStatus.TENTATIVE
        free = np.arange(len(clusters))
        pairs: list[tuple[IntArray, IntArray]] = []
        for rows in (np.flatnonzero(~tentative), np.flatnonzero(tentative)):
            i, j = assign(
                expected[rows],
                total[rows],
                bank.radius_m[rows],
                measured[np.ix_(rows, free)],
                clusters.radius_m[free],
                kalman.measurement,
                self._config,
            )
            pairs.append((rows[i], free[j]))
            free = np.delete(free, j)
        return np.concatenate([pairs[0][0], pairs[1][0]]), np.concatenate([pairs[0][1], pairs[1][1]])

    def _correct(
        self,
        bank: TrackBank,
        kalman: BatchFilter,
        rows: IntArray,
        measured: FloatArray,
        noise: FloatArray,
        world_from_sensor: FloatArray,
    ) -> None:
        """Updates every mode of these tracks, and the modes' probabilities."""
        n, m, d = len(rows), *bank.states.shape[1:]
        states = bank.states[rows].reshape(n * m, d)
        covariances = bank.covariances[rows].reshape(n * m, d, d)
        corrected = kalman.update(
            states,
            covariances,
            kalman.expect(states, covariances, world_from_sensor),
            np.repeat(measured, m, axis=0),
            np.repeat(noise, m, axis=0),
        )
        bank.states[rows] = corrected.state.reshape(n, m, d)
        bank.covariances[rows] = corrected.covariance.reshape(n, m, d, d)
        bank.modes[rows] = reweighed(bank.modes[rows], corrected.log_likelihood.reshape(n, m))

    def _noise(
        self,
        bank: TrackBank,
        kalman: BatchFilter,
        rows: IntArray,
        state: FloatArray,
        world_from_sensor: FloatArray,
        differs_m: FloatArray | float = 0.0,
        along_m: FloatArray | None = None,
    ) -> FloatArray:
        """(k, ., .) measurement noise of tracks `rows`, where they are expected to be seen, with one more
        standard deviation `differs_m` (k,) along the line of sight and across it, and further ones
        along the vectors `along_m` (k, s, 3), world."""
        rotation = world_from_sensor[:3, :3]
        points = (state[rows, :3] - world_from_sensor[:3, 3]) @ rotation
        variance = nominal_variance(points, bank.radius_m[rows], bank.height_m[rows], self._config)
        variance *= bank.noise_scale[rows]
        variance[:, :2] += np.square(differs_m)[..., None]
        spread_m = bank.spread_m[rows, None, :]
        if along_m is not None:
            spread_m = np.concatenate([spread_m, along_m], axis=1)
        return kalman.measurement.noise(points, variance, spread_m @ rotation)

    def _count_hidden(self, bank: TrackBank, clusters: Clusters, dt: float) -> None:
        """Adds dt (s) to the time for which unseen tracks have been hidden; those that were seen begin at zero."""
        unseen = np.flatnonzero(bank.cluster_id == NO_ID)
        hidden_s = np.zeros(len(bank))
        if len(unseen) and not clusters.planar:
            state, _ = combine(bank.states[unseen], bank.covariances[unseen], bank.modes[unseen])
            hidden_s[unseen] = bank.hidden_s[unseen] + dt * is_hidden(state[:, :3], clusters)
        bank.hidden_s = hidden_s

    def _end_and_confirm(self, bank: TrackBank) -> None:
        config = self._config
        seen = bank.cluster_id != NO_ID
        tentative = bank.status == TrackStatus.TENTATIVE
        hopeless = tentative & (bank.frames - bank.hits > config.confirm_window - config.confirm_hits)
        # What was followed for a moment only is more likely clutter than an obstacle that hides.
        longest_coast_s = np.minimum(config.max_coast_s, bank.seen_s - bank.born_s)
        excused_s = np.minimum(bank.hidden_s, HIDDEN_FACTOR * longest_coast_s)
        lost = ~seen & ~tentative & (self._now_s - bank.seen_s - excused_s > longest_coast_s + 1e-9)
        bank.status[~tentative & ~seen] = TrackStatus.COASTING
        bank.status[(~tentative & seen) | (bank.hits >= config.confirm_hits)] = TrackStatus.CONFIRMED
        bank.status[~tentative & ~seen] = TrackStatus.COASTING
        bank.status[hopeless | lost] = TrackStatus.ENDED

    def _born(self, kalman: BatchFilter, clusters: Clusters, rows: IntArray) -> TrackBank:
        """New tentative tracks from these clusters, without identifiers."""
        n, m, d = len(rows), len(self._chain.noise_factor), kalman.motion.dimension
        is_piece, spread_m = wall_pieces(clusters, self._config.structure_length_m)
        rotation = clusters.world_from_sensor[:3, :3]
        points = clusters.centre_sensor_m[rows]
        variance = nominal_variance(points, clusters.radius_m[rows], clusters.height_m[rows], self._config)
        state = np.zeros((n, d))
        state[:, :3] = clusters.centre_m[rows]
        covariance = np.zeros((n, d, d))
        covariance[:, np.arange(d), np.arange(d)] = kalman.motion.initial_variance
        placed = noise_along_axes(points, variance, spread_m[rows, None, :] @ rotation)
        covariance[:, :3, :3] = rotation @ placed @ rotation.T
        born = TrackBank.empty(m, d)
        born.track_id = np.full(n, NO_ID, dtype=np.int64)
        born.status = np.full(
            n, TrackStatus.CONFIRMED if self._config.confirm_hits == 1 else TrackStatus.TENTATIVE, dtype=np.int64
        )
        born.states = np.repeat(state[:, None], m, axis=1)
        born.covariances = np.repeat(symmetrised(covariance)[:, None], m, axis=1)
        born.modes = np.tile(self._chain.at_first(clusters.planar), (n, 1))
        born.noise_scale = np.ones((n, 3))
        born.spread_m = spread_m[rows]
        born.radius_m = clusters.radius_m[rows].copy()
        born.height_m = clusters.height_m[rows].copy()
        born.is_static = is_piece[rows]
        born.is_structure = is_piece[rows]
        born.cluster_id = clusters.cluster_id[rows].astype(np.int64)
        born.born_s = np.full(n, self._now_s)
        born.seen_s = np.full(n, self._now_s)
        born.whole_s = np.full(n, self._now_s)
        born.hidden_s = np.zeros(n)
        born.hits = np.ones(n, dtype=np.int64)
        born.misses = np.zeros(n, dtype=np.int64)
        born.frames = np.ones(n, dtype=np.int64)
        born.nis = np.full(n, np.nan)
        born.bodies = Bodies.seen_first(
            clusters.centre_m[rows, :2],
            clusters.length_m[rows],
            clusters.width_m[rows],
            clusters.yaw_rad[rows],
            self._config,
        )
        born.seen_at_m = clusters.centre_m[rows, :2].copy()
        born.sightings = Sightings.empty(n)
        return born

    def _record(self, bank: TrackBank, clusters: Clusters) -> Tracks:
        state, covariance = combine(bank.states, bank.covariances, bank.modes)
        return Tracks(
            frame_index=clusters.frame_index,
            stamp_ns=clusters.stamp_ns,
            world_from_sensor=clusters.world_from_sensor,
            model=self._config.model,
            track_id=bank.track_id.copy(),
            status=bank.status.copy(),
            state=state,
            covariance=covariance,
            radius_m=bank.radius_m.copy(),
            height_m=bank.height_m.copy(),
            is_static=bank.is_static.copy(),
            cluster_id=bank.cluster_id.copy(),
            age_s=self._now_s - bank.born_s,
            hits=bank.hits.copy(),
            misses=bank.misses.copy(),
            nis=bank.nis.copy(),
            manoeuvre=bank.modes[:, -1].copy(),
        )


def track_clusters(
    clusters: Iterable[Clusters], config: TrackingConfig, notes: Notes, timer: Timer = no_timer
) -> Iterator[Tracks]:
    """One `Tracks` a frame, in order."""
    tracker = Tracker(config, notes, timer)
    for frame in clusters:
        yield tracker(frame)


def select_clusters(clusters: Clusters, rows: BoolArray) -> Clusters:
    """The same frame with these clusters only."""
    return replace(
        clusters,
        cluster_id=clusters.cluster_id[rows],
        centre_m=clusters.centre_m[rows],
        centre_sensor_m=clusters.centre_sensor_m[rows],
        radius_m=clusters.radius_m[rows],
        height_m=clusters.height_m[rows],
        length_m=clusters.length_m[rows],
        width_m=clusters.width_m[rows],
        yaw_rad=clusters.yaw_rad[rows],
        points=clusters.points[rows],
        probability=clusters.probability[rows],
        split_from=clusters.split_from[rows],
    )
