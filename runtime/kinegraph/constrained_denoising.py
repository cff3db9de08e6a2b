"""Second stage under constraints: the energy of what a clip has to do pulls its latents.

EnergyMoGen composes by adding energies to a latent's (Eq. 6-8); a constraint is one more. At the last steps of each
level, with a = alpha_bar, z_0 = (z_t - sqrt(1 - a) eps) / sqrt(a) the predicted clean latent and g = dE_c / dz_0:

    eps <- eps + sqrt(a / (1 - a)) w s g

which moves z_0 by -w s g (classifier guidance, Dhariwal & Nichol, 2021, Alg. 2, on the clean estimate, as in DPS: Chung
et al., 2023, Eq. 16). g goes through the decoder of the level (its vector-Jacobian product, a graph of the bundle) and
the integration of the root (`motion.features`). s is Polyak's step, and bounded (`MAX_PULL`).

After the finest level the latent itself descends the energy (`diffusion.descent`), held to where it started.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from kinegraph.arrays import DoubleArray, FloatArray, Floats
from kinegraph.bundle.contract import LEVELS
from kinegraph.bundle.manifest import Manifest
from kinegraph.bundle.sessions import Sessions, run_model
from kinegraph.clip import Clip
from kinegraph.conditioning import Conditions
from kinegraph.constraint_values import check_total_weight
from kinegraph.constraints import Constraint, Miss
from kinegraph.decoding import MotionDecoder, tell_turn
from kinegraph.denoising import LatentSampler, OnLatent, sample_hierarchy
from kinegraph.diffusion.composition import CompositionWeights
from kinegraph.diffusion.constraint_energy import Term, constraint_terms, seam_terms, total_energy
from kinegraph.diffusion.descent import Evaluation, Limits, descend
from kinegraph.diffusion.sampling import DdimCoefficients, OnStep, PredictNoise, StepInfo, is_stop
from kinegraph.errors import Cancelled, InvalidInputError, MissedConstraintError
from kinegraph.feasibility import check_constraints
from kinegraph.keeping import Kept
from kinegraph.motion.energies import TOES, Energy, floor_energy, stance_energy
from kinegraph.motion.features import LAYOUT, joints_from_features, joints_vjp
from kinegraph.motion.postprocess import enforce_bone_lengths, find_contacts, lock_feet, sliding_speed
from kinegraph.motion.reaching import Pins, reach
from kinegraph.motion.skeleton import bone_lengths
from kinegraph.options import LATENT, GenerateOptions
from kinegraph.placements import misses_of, pins_of
from kinegraph.validation import check_flag

MAX_PULL: Final = 0.5
"""Largest root mean square by which one step moves the clean latent, whose channels have a deviation of 1."""
PULLED_FROM: Final = 0.25
"""Share of a level's steps before the first that is pulled: at first the clean estimate is noise yet.

At the finest level only the last step is: what motion it is, the coarser levels have decided, and the descent goes on
from there (measured: with all steps pulled and shorter descents, paths are missed by twice as much).
"""
MAX_LATENT: Final = 1.3
"""Largest root mean square of a pulled latent: further out the decoder knows no motion, whatever is wanted."""
DESCENT_STEPS: Final = 18
"""Steps of the descent on the finest latent; they count as steps of the call."""
STALL_STEPS: Final = 4
STALLED: Final = 0.9
"""Share of the energy of what is wanted: a descent that leaves more of it in `STALL_STEPS` ends."""
MAX_AWAY: Final = 0.8
"""Largest root mean square by which the descent moves the latent."""
CLOSE: Final = 0.008
"""Metres, root mean square of a constraint of weight 1: so near, the descent ends."""
HOLD: Final = 0.005
"""How strongly the descent holds the latent to where diffusion left it, m^2."""
STANCE_WEIGHT: Final = 4.0
"""Weight of planted feet that slide, and of feet under the floor, in the descent."""
REACHING_ROUNDS: Final = 2
"""Corrections in the joints, at most: the first moves what the places of `EndPose` and `Loop` depend on."""
REACHED: Final = 1e-3
"""Metres: a correction that leaves less is the last one."""
MISSED: Final = 0.05
"""Metres from which a miss is told in the clip's notes."""


@dataclass(frozen=True)
class Wanted:
    """What one call wants besides its sentence, checked as far as that goes without a clip."""

    constraints: tuple[Constraint, ...]
    weight: float
    """Of all constraints against the text."""
    fix: bool
    """Whether the joints are corrected after the last latent (`motion.reaching`)."""
    strict: bool
    notes: tuple[str, ...] = ()
    kept: Kept | None = None
    """What an edit keeps of a clip."""
    begin: EncodedClip | None = None
    """Where an edit begins at the finest level."""

    @staticmethod
    def check(
        constraints: object, weight: object, fix: object, strict: bool, sampler: LatentSampler, most: int | None = None
    ) -> Wanted:
        """Check everything that needs no clip, which has `most` frames; None is what the bundle makes at a time.

        Raises:
            InvalidInputError: no constraints, a weight that is none, a bundle of other features, or one without
                gradients of its decoders, which latent space needs.
        """
        manifest = sampler.manifest
        check_flag(fix, "constraint_fix")
        number = check_total_weight(weight)
        checked, _ = check_constraints(constraints, most or manifest.frames.max, manifest.fps)
        if sampler.space == LATENT:
            require_gradients(sampler)
        require_layout(manifest)
        return Wanted(checked, number, bool(fix), strict)

    def for_clip(self, frames: int, fps: float) -> Wanted:
        """Check the constraints against the length of the clip; see `feasibility.check_constraints`."""
        checked, notes = check_constraints(self.constraints, frames, fps, strict=self.strict)
        return replace(self, constraints=checked, notes=notes)

    @property
    def acts(self) -> bool:
        """Whether anything pulls: weights of 0 are a clip without constraints, bit for bit."""
        return self.weight > 0 and (self.kept is not None or any(each.weight > 0 for each in self.constraints))

    def terms(self, frames: int, fps: float, *, leading: bool = False) -> tuple[Term, ...]:
        """List the energies of all that is wanted."""
        kept = () if self.kept is None else (self.kept.energy,)
        return (*constraint_terms(self.constraints, frames, fps, leading=leading), *kept)

    def pins(self, joints: FloatArray, fps: float) -> Pins:
        """Collect the places of all that is wanted; those of constraints count before what is kept."""
        pins = pins_of(self.constraints, joints.astype(np.float64), fps)
        if self.kept is None:
            return pins
        kept = self.kept.pins(joints.astype(np.float64))
        target = np.where(pins.wanted, pins.target, kept.target)
        certain = np.where(pins.wanted, False if pins.certain is None else pins.certain, kept.wanted)
        return Pins(target, pins.wanted | kept.wanted, certain)

    def misses(self, joints: FloatArray, fps: float) -> tuple[Miss, ...]:
        """Measure how far a motion is from each constraint, and from what is kept."""
        kept = () if self.kept is None else (self.kept.miss(joints.astype(np.float64)),)
        return (*misses_of(self.constraints, joints.astype(np.float64), fps), *kept)


@dataclass(frozen=True)
class EncodedClip:
    """A clip as a latent of the finest level, from which an edit begins."""

    latent: FloatArray
    """(1, C, z)."""
    strength: float
    """Share of the steps that are taken: 1 begins at pure noise, and then the latent does not count."""

    def first_step(self, steps: int) -> int:
        """Tell at which step of a run the edit begins."""
        return min(round((1.0 - self.strength) * steps), steps - 1)

    def noised(self, alpha: float, noise: FloatArray) -> FloatArray:
        """Add noise: sqrt(a) z + sqrt(1 - a) noise, as SDEdit does (Meng et al., 2022, Alg. 1)."""
        return np.asarray(np.sqrt(alpha) * self.latent + np.sqrt(1.0 - alpha) * noise, dtype=np.float32)


def require_gradients(sampler: LatentSampler) -> None:
    """Refuse a bundle that cannot be pulled.

    Raises:
        InvalidInputError: it has no gradients of its decoders.
    """
    manifest = sampler.manifest
    if not sampler.sessions.decoder_gradients:
        raise InvalidInputError(
            f"bundle {manifest.name} {manifest.version} has no gradients of its decoders, which constraints need; "
            "leave them out, or add the graphs: python -m kinegraph_export.add_gradients"
        )


def require_layout(manifest: Manifest) -> None:
    """Refuse a bundle (`InvalidInputError`) whose features are of another layout than joints-137."""
    if manifest.features.layout != LAYOUT:
        layout = manifest.features.layout
        raise InvalidInputError(f"constraints and edits need features of the layout joints-137, not {layout}")


def sample_constrained(
    sampler: LatentSampler,
    decoder: MotionDecoder,
    conditions: Conditions,
    weights: CompositionWeights | None,
    options: GenerateOptions,
    caption: str,
    wanted: Wanted,
    on_step: OnStep | None = None,
    on_latent: OnLatent | None = None,
) -> Clip:
    """Sample, decode and correct one clip under constraints.

    Args:
        sampler, decoder: of the bundle.
        conditions, weights: as in `LatentSampler.sample`; one sample.
        options: of the clip.
        caption: of the clip.
        wanted: its constraints, checked for its length.
        on_step: called after every step, those of the descent included.
        on_latent: see `denoising.sample_hierarchy`.

    Raises:
        Cancelled, NonFiniteError: as in `denoising.sample_hierarchy`.
        MissedConstraintError: with `strict`, a constraint was missed by more than `MISSED`.
    """
    if wanted.acts:
        joints = _sample_joints(sampler, decoder, conditions, weights, options, wanted, on_step, on_latent)
    else:
        latents = sampler.sample(conditions, weights, [options], on_step, on_latent)
        joints = decoder.decode(latents, [options], [caption])[0].joints
    return told_clip(joints, wanted, options, caption, sampler.manifest)


def told_clip(joints: FloatArray, wanted: Wanted, options: GenerateOptions, caption: str, manifest: Manifest) -> Clip:
    """Make the clip of joints (frames, 22, 3) that tells how far it is from what was wanted.

    Raises:
        MissedConstraintError: with `strict`, a constraint was missed by more than `MISSED`.
    """
    misses = wanted.misses(joints, manifest.fps)
    weights_of = [constraint.weight for constraint in wanted.constraints] + [1.0] * (wanted.kept is not None)
    missed = tuple(
        f"{miss.what}: missed by {100 * miss.metres:.0f} cm"
        for miss, weight in zip(misses, weights_of, strict=True)
        if miss.metres > MISSED and weight * wanted.weight > 0
    )
    if missed and wanted.strict:
        raise MissedConstraintError(f"{missed[0]}; change it, or leave out strict to come as near as it goes")
    bundle = f"{manifest.name} {manifest.version}"
    notes = (*wanted.notes, *missed, *tell_turn(joints, options))
    return Clip(joints, manifest.fps, options.seed, caption, bundle, notes=notes, misses=misses)


def _sample_joints(
    sampler: LatentSampler,
    decoder: MotionDecoder,
    conditions: Conditions,
    weights: CompositionWeights | None,
    options: GenerateOptions,
    wanted: Wanted,
    on_step: OnStep | None,
    on_latent: OnLatent | None,
) -> FloatArray:
    """Sample latents under constraints, descend on the finest one, decode it, and correct the joints."""
    manifest, frames = sampler.manifest, options.frames
    fps = manifest.fps
    leading = wanted.terms(frames, fps, leading=True)
    alpha_bar = sampler.schedule.alphas_cumprod

    def make_predictor(level: str, ddim: DdimCoefficients, coarse: FloatArray | None) -> PredictNoise:
        predict = sampler.predictor(conditions, weights, [options], level, ddim, coarse)
        energy = DecodedEnergy(sampler.sessions, manifest, level, frames, leading)
        last = len(ddim.timesteps) - 1
        pulled_from = last if level == LEVELS[-1] else min(PULLED_FROM * (last + 1), last)
        pulled = ConstrainedPrediction(predict, energy, alpha_bar[ddim.timesteps], wanted.weight, pulled_from)
        if wanted.begin is None or level != LEVELS[-1]:
            return pulled
        first = wanted.begin.first_step(len(ddim.timesteps))
        return BegunPrediction(pulled, ddim, wanted.begin.noised(alpha_bar[ddim.timesteps[first]], noise[-1]), first)

    progress = _Progress(on_step)
    noise, levels = sampler.initial_noise([options]), sampler.level_plans(options)
    latents = sample_hierarchy(levels, noise, make_predictor, sampler.schedule, progress.diffused, on_latent)[-1]
    terms = wanted.terms(frames, fps)
    energy = DecodedEnergy(sampler.sessions, manifest, LEVELS[-1], frames, terms)
    wants = _Metered(terms)
    natural: tuple[Term, ...] = (_Standing(fps), *seam_terms(wanted.constraints, frames, fps))
    standing = replace(energy, terms=(wants, *natural))
    enough = 0.5 * CLOSE**2 * (sum(constraint.weight for constraint in wanted.constraints) + (wanted.kept is not None))
    limits = Limits(steps=DESCENT_STEPS, hold=HOLD / max(wanted.weight, 1e-3), away=MAX_AWAY)

    lowest: list[float] = []

    def after(number: int) -> bool:
        progress.descended(number)
        lowest.append(min([wants.energy, *lowest[-1:]]))
        return lowest[-1] <= enough or stalls(lowest)

    latents = descend(standing, latents, limits, after)
    progress.finished()
    joints = enforce_bone_lengths(joints_from_features(energy.decode(latents)), decoder.bones)
    if not wanted.fix:
        return lock_feet(joints, fps) if options.foot_fix else joints
    return corrected(joints, wanted, fps, foot_fix=options.foot_fix)


def corrected(joints: FloatArray, wanted: Wanted, fps: float, *, foot_fix: bool) -> FloatArray:
    """Close what the latent leaves of the way to what is wanted, in the joints (`motion.reaching`).

    Args:
        joints: (frames, 22, 3) metres, with rigid bones.
        wanted: of the clip.
        fps: frames per second.
        foot_fix: lock planted feet.
    """
    lengths = np.median(bone_lengths(joints), axis=0)
    for number in range(REACHING_ROUNDS):
        pins = wanted.pins(joints, fps)
        if number > 0 and np.abs(pins.missed(joints)).max() < REACHED:
            break
        joints = reach(joints, pins, lengths, fps, foot_fix=foot_fix)
    return joints


def _standing_terms(joints: Floats, fps: float) -> tuple[Term, ...]:
    """Make the energy of feet that stand where they stood, and not under the floor."""
    planted = np.zeros((len(joints) - 1, len(TOES)))
    weight = STANCE_WEIGHT / len(joints)
    speed = sliding_speed(joints, fps)
    for index, toe in enumerate(TOES):
        for start, end in find_contacts(joints[:, toe].astype(np.float64), fps, speed):
            planted[start : end - 1, index] = weight

    def stance(moved: Floats) -> Energy:
        return stance_energy(moved, planted)

    def floor(moved: Floats) -> Energy:
        return floor_energy(moved, weight)

    return stance, floor


@dataclass
class _Standing:
    """The energy of feet that stand as in the first motion that it is given: where the descent begins."""

    fps: float
    terms: tuple[Term, ...] = ()

    def __call__(self, joints: Floats) -> Energy:
        self.terms = self.terms or _standing_terms(joints, self.fps)
        return total_energy(self.terms, joints)


@dataclass
class _Metered:
    """The energy of what is wanted as one term, which remembers its last value."""

    terms: Sequence[Term]
    energy: float = np.inf

    def __call__(self, joints: Floats) -> Energy:
        self.energy, gradient = total_energy(self.terms, joints)
        return self.energy, gradient


def stalls(energies: Sequence[float]) -> bool:
    """Tell whether the last `STALL_STEPS` of a descent hardly lowered the energy of what is wanted.

    Args:
        energies: the lowest so far, after each step.
    """
    return len(energies) > STALL_STEPS and energies[-1] > STALLED * energies[-1 - STALL_STEPS]


@dataclass
class _Progress:
    """Reports the steps of diffusion and of the descent as those of one run."""

    on_step: OnStep | None
    last: StepInfo | None = None

    def diffused(self, info: StepInfo) -> bool | None:
        """Report a diffusion step; the steps of the descent are still to come."""
        self.last = replace(info, total=info.total + DESCENT_STEPS)
        return None if self.on_step is None else self.on_step(self.last)

    reported: int = 0

    def finished(self) -> None:
        """Report the last step, where the descent ended before."""
        if self.reported < DESCENT_STEPS:
            self.descended(DESCENT_STEPS)

    def descended(self, number: int) -> None:
        """Report a step of the descent.

        Raises:
            Cancelled: the caller said so.
        """
        self.reported = number
        if self.on_step is None or self.last is None:
            return
        done = self.last.done + number
        info = StepInfo("constraints", number, DESCENT_STEPS, done, self.last.total, 0)
        if is_stop(self.on_step(info)):
            raise Cancelled(f"stopped by on_step at step {done} of {self.last.total}")


@dataclass(frozen=True)
class DecodedEnergy:
    """Energy of a level's latent, through its decoder, of one sample."""

    sessions: Sessions
    manifest: Manifest
    level: str
    frames: int
    terms: Sequence[Term]

    def decode(self, latent: FloatArray) -> DoubleArray:
        """Decode a latent (1, C, z) to features (frames, F), not normalised."""
        inputs = {"latent": latent, "frame_mask": self._mask()}
        (features,) = run_model(self.sessions.decoder_of(self.level), ["features"], inputs, "the decoder")
        return self._without_padding(features)

    def __call__(self, latent: FloatArray) -> Evaluation:
        """Compute the energy of a latent (1, C, z), and how to compute its gradient (1, C, z)."""
        decoder = self.sessions.decoder_gradients[self.level]()
        normalised, back = decoder.decode({"latent": latent, "frame_mask": self._mask()})
        features = self._without_padding(normalised)
        energy, of_joints = total_energy(self.terms, joints_from_features(features).astype(np.float64))

        def gradient() -> FloatArray:
            cotangent = np.zeros_like(normalised)
            cotangent[0, : self.frames] = joints_vjp(features, of_joints) * np.array(self.manifest.features.std)
            return back(cotangent)

        return energy, gradient

    def _without_padding(self, normalised: FloatArray) -> DoubleArray:
        mean, std = np.array(self.manifest.features.mean), np.array(self.manifest.features.std)
        return np.asarray(normalised[0, : self.frames] * std + mean)

    def _mask(self) -> FloatArray:
        group = self.manifest.frames.per_token
        mask = np.zeros((1, -(-self.frames // group) * group), dtype=np.float32)
        mask[0, : self.frames] = 1.0
        return mask


@dataclass(frozen=True)
class ConstrainedPrediction:
    """A level's noise prediction with the pull of constraints; a `PredictNoise`."""

    predict: PredictNoise
    energy: DecodedEnergy
    alpha_bar: DoubleArray
    """(K,) at the steps."""
    weight: float
    first: float
    """Step from which on it is pulled."""

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        noise = self.predict(latents, index)
        if index < self.first:
            return noise
        alpha = float(self.alpha_bar[index])
        clean = ((latents - np.sqrt(1.0 - alpha) * noise) / np.sqrt(alpha)).astype(np.float32)
        energy, gradient = self.energy(clean)
        # Polyak's step already ends where a linear energy is 0: a heavier weight counts in the descent
        pulled = clean - np.float32(min(self.weight, 1.0)) * polyak_pull(energy, gradient())
        pulled *= min(1.0, max(MAX_LATENT, _size(clean)) / max(_size(pulled), 1e-12))
        return np.asarray(noise + np.float32(np.sqrt(alpha / (1.0 - alpha))) * (clean - pulled), dtype=np.float32)


@dataclass(frozen=True)
class BegunPrediction:
    """A noise prediction whose run begins at a later step, at a latent that is given; a `PredictNoise`."""

    predict: PredictNoise
    ddim: DdimCoefficients
    latent: FloatArray
    """(B, C, z) at the step where the run begins."""
    first: int

    def __call__(self, latents: FloatArray, index: int) -> FloatArray:
        if index >= self.first:
            return self.predict(latents, index)
        if index < self.first - 1:
            return np.zeros_like(latents)
        # the noise with which the DDIM step, keep z + move eps, arrives at the latent
        arriving = (self.latent - self.ddim.keep[index] * latents) / self.ddim.move[index]
        return np.asarray(arriving, dtype=np.float32)


def _size(latents: FloatArray) -> float:
    """Compute the root mean square."""
    return float(np.sqrt((latents.astype(np.float64) ** 2).mean()))


def polyak_pull(energy: float, gradient: FloatArray) -> FloatArray:
    """Scale a gradient to the step after which a half square that is linear would be 0, at most `MAX_PULL` in rms.

    Of E = r^2 / 2 with r linear along the gradient it is 2 E / |g|^2 g (Polyak, 1987, Eq. 5.38).
    """
    square = float((gradient.astype(np.float64) ** 2).sum())
    if square <= 0:
        return np.zeros_like(gradient)
    step = 2.0 * energy / square
    root_mean_square = step * np.sqrt(square / gradient.size)
    return np.asarray(gradient * np.float32(step * min(1.0, MAX_PULL / max(root_mean_square, 1e-12))), dtype=np.float32)
