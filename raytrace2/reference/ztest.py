"""Do two renders of one scene differ by more than noise?

Both sides give independent batches of the same number of samples a pixel. Four questions are asked, each at a quarter
of the false-alarm rate (Bonferroni), and the renders are consistent when none is answered with no:

- *exact*: are there pixels on which neither side varies, but which differ?
- *pixels*: is the share of pixels whose Welch t-test fails at p < 0.01 greater than chance explains? (Not asked, p = 1,
  when one side is noisier than the other by more than a quarter in variance: t of skewed noise then fails too often.)
- *tiles*: does the mean of any window of 8, 16 or 32 pixels (more in big images) differ? Averaging finds a small bias
  that no pixel shows.
- *mean*: does the mean of the whole image differ, in any channel or in luminance?

The last three are judged by relabelling batches (:mod:`.relabel`), which needs no assumption about the noise but that
both sides have the same; where they need not, Welch's t must agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .metrics import LUMINANCE
from .relabel import Labellings, distinct, labellings, relabelling_counts, relabelling_pvalue, welch_t, welch_z
from .student import binomial_quantile, normal_pvalue, t_pvalue
from .windows import Windows, window_means, windows

FAILING_P = 0.01
_FAILING_Z = 2.5758293035489004
_WINDOW_SIZES = (8, 16, 32)
_WINDOWS_AT_MOST = 12_000
_PIXELS_RELABELLED = 1 << 15
# Relabelling overstates the noise of each side when one is much noisier, so that p itself bounds the share from below;
# and Welch's approximation is off by a few per cent then: a share that exceeds chance by less than this factor is no
# evidence.
_SHARE_SLACK = 1.25
_ALIKE = 1.25


@dataclass(frozen=True, eq=False)
class NoiseTest:
    """The verdict and every figure it rests on. ``false_alarm_rate``: the chance that ``consistent`` is False for two
    renderers that sample the same distribution.

    ``failing_share``: share of pixels whose luminance fails at p < 0.01, ``chance_share``: what relabelled batches
    give, ``failing_bound``: what a binomial distribution of ``effective_pixels`` independent pixels exceeds too rarely
    to believe; ``failing_share_rgb`` is the share per channel. ``p_*`` are the p-values of the four questions, each to
    be compared with ``false_alarm_rate / 4``. ``worst_tile``: (y0, x0, y1, x1) of the window with the greatest |z|,
    ``worst_tile_z``. ``mean_difference``: (ours - reference) / reference of the image mean per channel, ``mean_z`` its
    z. ``mismatched_pixels``: pixels that are constant on both sides and differ; ``nonfinite_pixels``: ours not finite
    where the reference is finite; ``unjudged_pixels``: the reference itself is not finite. Maps: ``z`` (H, W, 4) signed
    z of ours - reference per channel and luminance, ``p`` (H, W, 4) its p-values, ``failing`` (H, W) bool. ``reasons``
    says in words what failed."""

    consistent: bool
    false_alarm_rate: float
    batches: tuple[int, int]
    failing_share: float
    failing_share_rgb: tuple[float, float, float]
    chance_share: float
    failing_bound: float
    effective_pixels: float
    p_exact: float
    p_pixels: float
    p_tiles: float
    p_mean: float
    worst_tile: tuple[int, int, int, int]
    worst_tile_z: float
    mean_difference: tuple[float, float, float]
    mean_z: tuple[float, float, float, float]
    noise_ratio: float
    mismatched_pixels: int
    nonfinite_pixels: int
    unjudged_pixels: int
    reasons: tuple[str, ...]
    z: np.ndarray
    p: np.ndarray
    failing: np.ndarray


def ztest(
    ours: npt.ArrayLike,
    reference: npt.ArrayLike,
    *,
    false_alarm_rate: float = 1e-3,
    tolerance: float = 1e-4,
    seed: int = 0,
) -> NoiseTest:
    """Tests batch means (B, H, W, 3) of ours against those of the reference; B may differ, 8 and 8 is the least at
    1e-3.

    Every batch must be of the same number of samples a pixel on both sides: then the false-alarm rate is exact for
    renderers whose samples are alike, and approximate when one is noisier. ``tolerance``: a relative difference that is
    rounding, not error. Sums of n float32 radiances err by about sqrt(n) 6e-8 and in the worst case by n 6e-8, and
    films add a few thousand weighted samples a pixel, so that 1e-4 covers both sides. ``seed`` chooses the labellings.
    """
    a, b = (np.asarray(v, dtype=np.float32) for v in (ours, reference))
    if a.ndim != 4 or a.shape[3] != 3 or a.shape[1:] != b.shape[1:] or 0 in a.shape or 0 in b.shape:
        raise ValueError(f"batch means must be (B, H, W, 3) of the same image size: {a.shape} and {b.shape}")
    na, nb = len(a), len(b)
    each = false_alarm_rate / 4.0
    labels = labellings(na, nb, each, seed)

    batches = np.concatenate([a, b])
    broken_ours, broken_reference = (np.asarray(~np.isfinite(side).all(axis=(0, 3))) for side in (a, b))
    broken = broken_ours | broken_reference
    if broken.any():
        batches = np.where(broken[..., None], np.float32(0.0), batches)
    batches = np.concatenate([batches, (batches @ LUMINANCE)[..., None].astype(np.float32)], axis=3)
    judged = int((~broken).sum())
    nonfinite = broken_ours & ~broken_reference

    floor = 1e-2 * tolerance * float(np.abs(batches).mean(dtype=np.float64))
    z, p = _pixels(batches, na, tolerance, floor)
    mismatched, p_exact = _exact(batches[..., :3], na, tolerance, floor)
    failing = (p[..., 3] < FAILING_P) | mismatched | nonfinite
    share = float(failing.sum()) / max(1, judged + int(nonfinite.sum()))

    noise_ratio = _noise_ratio(batches[..., 3], na)
    p_pixels, chance = _relabel_pixels(batches[..., 3], tolerance, floor, labels)
    if not 1.0 / _ALIKE <= noise_ratio <= _ALIKE:
        p_pixels = 1.0
    effective = judged / _correlation_inflation(batches[..., 3], na)
    bound = binomial_quantile(effective, min(1.0, _SHARE_SLACK * max(chance, FAILING_P)), each)

    enlarge = 1
    while batches.shape[1] * batches.shape[2] / (4 * enlarge) ** 2 > _WINDOWS_AT_MOST:
        enlarge *= 2
    grid = windows(batches.shape[1:3], tuple(enlarge * size for size in _WINDOW_SIZES))
    tile_means = np.stack([window_means(batch, grid) for batch in batches])
    p_tiles, worst, worst_z = _tiles(tile_means, grid, na, tolerance, floor, labels)
    p_mean, mean_z, mean_difference = _mean(batches.mean(axis=(1, 2), dtype=np.float64), na, tolerance, labels)

    reasons = []
    if nonfinite.any():
        reasons.append(f"{int(nonfinite.sum())} pixels of ours are not finite")
    if p_exact <= each:
        reasons.append(f"{int(mismatched.sum())} pixels without noise differ")
    if p_pixels <= each and share > bound:
        reasons.append(f"{share:.2%} of the pixels fail at p < {FAILING_P}, where chance gives {chance:.2%}")
    if p_tiles <= each:
        y0, x0, y1, x1 = worst
        reasons.append(f"the window of rows {y0}:{y1}, columns {x0}:{x1} differs (z = {worst_z:+.1f})")
    if p_mean <= each:
        reasons.append("the image mean differs by " + ", ".join(f"{d:+.2%}" for d in mean_difference))
    return NoiseTest(
        consistent=not reasons,
        false_alarm_rate=false_alarm_rate,
        batches=(na, nb),
        failing_share=share,
        failing_share_rgb=tuple(float((p[..., c] < FAILING_P).sum()) / max(1, judged) for c in range(3)),  # type: ignore[arg-type]
        chance_share=chance,
        failing_bound=bound,
        effective_pixels=effective,
        p_exact=p_exact,
        p_pixels=p_pixels,
        p_tiles=p_tiles,
        p_mean=p_mean,
        worst_tile=worst,
        worst_tile_z=worst_z,
        mean_difference=mean_difference,
        mean_z=mean_z,
        noise_ratio=noise_ratio,
        mismatched_pixels=int(mismatched.sum()),
        nonfinite_pixels=int(nonfinite.sum()),
        unjudged_pixels=int(broken_reference.sum()),
        reasons=tuple(reasons),
        z=z,
        p=p,
        failing=failing,
    )


def _moments(batches: np.ndarray, na: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signed difference of the means, and the squared standard error of each."""
    a, b = batches[:na], batches[na:]
    difference = a.mean(axis=0, dtype=np.float64) - b.mean(axis=0, dtype=np.float64)
    va, vb = (side.var(axis=0, ddof=1, dtype=np.float64) / len(side) for side in (a, b))
    return difference, va, vb


def _margin(batches: np.ndarray, tolerance: float, floor: float) -> np.ndarray:
    return tolerance * np.abs(batches.mean(axis=0, dtype=np.float64)) + floor


def _signed_z(batches: np.ndarray, na: int, margin: np.ndarray) -> np.ndarray:
    difference, va, vb = _moments(batches, na)
    return np.sign(difference) * welch_z(np.abs(difference), va, vb, na, len(batches) - na, margin)


def _pixels(batches: np.ndarray, na: int, tolerance: float, floor: float) -> tuple[np.ndarray, np.ndarray]:
    margin = _margin(batches, tolerance, floor)
    difference, va, vb = _moments(batches, na)
    t, df = welch_t(np.abs(difference), va, vb, na, len(batches) - na, margin)
    return _signed_z(batches, na, margin).astype(np.float32), t_pvalue(t, df)


def _exact(batches: np.ndarray, na: int, tolerance: float, floor: float) -> tuple[np.ndarray, float]:
    """Pixels that do not vary on either side yet differ, and the exact p-value of finding so many.

    A labelling finds such a pixel when it splits the batches just where the pixel's two values do. So the p-value is
    the number of splits that occur at least as often as the true one, over the number of labellings."""
    n = len(batches)
    low, high = batches.min(axis=0), batches.max(axis=0)
    upper = batches > 0.5 * (low + high)
    margin = _margin(batches, tolerance, floor)
    spread = np.where(upper, high - batches, batches - low).max(axis=0)
    count = upper.sum(axis=0)
    candidate = (high - low > margin) & (spread <= 0.2 * margin) & ((count == na) | (count == n - na))
    splits = upper[:, candidate].T
    # A split and its complement separate the same batches; either may have ours as the upper value.
    splits = np.where(splits[:, :1], splits, ~splits)
    truth = np.arange(n) < na
    mismatched = np.zeros(candidate.shape, dtype=bool)
    mismatched[candidate] = (splits == truth).all(axis=1)
    found = int(mismatched.sum())
    if found == 0:
        return np.asarray(mismatched.any(axis=2)), 1.0
    _, occurrences = np.unique(splits, axis=0, return_counts=True)
    return np.asarray(mismatched.any(axis=2)), min(1.0, int((occurrences >= found).sum()) / distinct(na, n - na))


def _relabel_pixels(luminance: np.ndarray, tolerance: float, floor: float, labels: Labellings) -> tuple[float, float]:
    """p-value of the number of failing pixels, and the share that fails by chance. Big images are thinned out
    evenly."""
    columns = luminance.reshape(len(luminance), -1)
    columns = columns[:, :: -(-columns.shape[1] // _PIXELS_RELABELLED)]
    counts = relabelling_counts(columns, _margin(columns, tolerance, floor), _FAILING_Z, labels)
    return relabelling_pvalue(counts), float(counts[1:].mean()) / columns.shape[1]


def _relabel_greatest(columns: np.ndarray, margin: np.ndarray, z: np.ndarray, labels: Labellings) -> float:
    """p-value of the greatest |z| of all columns.

    Relabelling is exact when both sides are alike but too eager when one is much noisier; Welch's t with Bonferroni's
    correction is the other way round, sound for means of many pixels whatever their variances. The greater p is right
    in both cases.
    """
    greatest = float(np.abs(z).max())
    welch = min(1.0, z.size * normal_pvalue(greatest))
    if greatest == 0.0:
        return 1.0
    # Rounding must not make a labelling that ties with the truth look smaller.
    return max(welch, relabelling_pvalue(relabelling_counts(columns, margin, greatest * (1.0 - 1e-6), labels)))


def _noise_ratio(luminance: np.ndarray, na: int) -> float:
    """Median over pixels of the variance of a batch of ours over that of a batch of the reference; 1 without noise."""
    a, b = (side.var(axis=0, ddof=1, dtype=np.float64) for side in (luminance[:na], luminance[na:]))
    noisy = (a > 0.0) & (b > 0.0)
    return float(np.median(a[noisy] / b[noisy])) if noisy.any() else 1.0


def _correlation_inflation(luminance: np.ndarray, na: int, reach: int = 4) -> float:
    """By how much the pixels' correlation raises the variance of the number of failing pixels.

    "Fails" is an even function of the difference, so its expansion in Hermite polynomials starts with the second, and
    by Mehler's formula two pixels whose noise correlates by r have "fails" correlated by at most r^2. The variance of
    the count thus grows by at most the sum of r^2 over the neighbourhood: 1.6 for Mitsuba's default filter. r is
    measured on the residuals of batches from their mean."""
    residuals = []
    for side in (luminance[:na], luminance[na:]):
        deviation = side.std(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            residuals.append(np.where(deviation > 0.0, (side - side.mean(axis=0)) / deviation, 0.0))
    r = np.concatenate(residuals)
    power = float(np.mean(r * r, dtype=np.float64))
    if power == 0.0:
        return 1.0
    height, width = r.shape[1:]
    total = 1.0
    for dy in range(min(reach, height - 1) + 1):
        for dx in range(-min(reach, width - 1), min(reach, width - 1) + 1):
            if dy > 0 or dx > 0:
                here = r[:, : height - dy, max(0, -dx) : width - max(0, dx)]
                there = r[:, dy:, max(0, dx) : width - max(0, -dx)]
                total += 2.0 * (float(np.mean(here * there, dtype=np.float64)) / power) ** 2
    return total


def _tiles(
    means: np.ndarray, grid: Windows, na: int, tolerance: float, floor: float, labels: Labellings
) -> tuple[float, tuple[int, int, int, int], float]:
    columns = means.reshape(len(means), -1)
    margin = _margin(columns, tolerance, floor)
    flat = _signed_z(columns, na, margin)
    p = _relabel_greatest(columns, margin, flat, labels)
    z = flat.reshape(means.shape[1:])
    window, channel = np.unravel_index(int(np.abs(z).argmax()), z.shape)
    worst = (int(grid.y0[window]), int(grid.x0[window]), int(grid.y1[window]), int(grid.x1[window]))
    return p, worst, float(z[window, channel])


def _mean(
    means: np.ndarray, na: int, tolerance: float, labels: Labellings
) -> tuple[float, tuple[float, float, float, float], tuple[float, float, float]]:
    margin = _margin(means, tolerance, 0.0)
    z = _signed_z(means, na, margin)
    p = _relabel_greatest(means, margin, z, labels)
    own, theirs = means[:na].mean(axis=0)[:3], means[na:].mean(axis=0)[:3]
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(theirs == 0.0, np.inf * own, own / theirs - 1.0)
    relative = np.nan_to_num(relative, nan=0.0)
    return p, tuple(float(v) for v in z), tuple(float(v) for v in relative)  # type: ignore[return-value]
