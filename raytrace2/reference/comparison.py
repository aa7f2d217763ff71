"""What comparing our render with Mitsuba's gives: every figure in one frozen object that shows and reports itself."""

from __future__ import annotations

import html
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from .flip import flip
from .metrics import mae, psnr, relmse, rmse
from .report import png_uri, srgb_bytes, write_report
from .ztest import NoiseTest, ztest


@dataclass(frozen=True, eq=False)
class Comparison:
    """``ours`` and ``reference``: (H, W, 3) float32 linear; ``flip_map`` (H, W). ``seconds`` and ``reference_seconds``
    are the warm times of the two renders. ``noise`` is None when there were too few batches to ask. ``settings`` are
    the rows of the report's second table."""

    title: str
    ours: np.ndarray
    reference: np.ndarray
    rmse: float
    relmse: float
    mae: float
    psnr: float
    flip: float
    flip_map: np.ndarray
    seconds: float
    reference_seconds: float
    noise: NoiseTest | None
    settings: Mapping[str, str]

    @property
    def consistent(self) -> bool | None:
        """Whether the two differ by no more than noise; None when that was not tested."""
        return None if self.noise is None else self.noise.consistent

    def figures(self) -> dict[str, str]:
        """The figures with their names, as tables show them."""
        rows = {
            "RMSE": f"{self.rmse:.4g}",
            "relMSE": f"{self.relmse:.4g}",
            "Mean absolute difference": f"{self.mae:.4g}",
            "PSNR": f"{self.psnr:.2f} dB",
            "FLIP": f"{self.flip:.4f}",
        }
        if self.noise is not None:
            n = self.noise
            rows |= {
                "Pixels that fail at p < 0.01": f"{n.failing_share:.2%} (chance gives {n.chance_share:.2%}, "
                f"noise stays below {n.failing_bound:.2%})",
                "p: noiseless pixels, pixels, tiles, mean": ", ".join(
                    f"{p:.2g}" for p in (n.p_exact, n.p_pixels, n.p_tiles, n.p_mean)
                ),
                "Each p fails at": f"{n.false_alarm_rate / 4.0:.2g} "
                f"(false alarms: {n.false_alarm_rate:.1g} of all comparisons)",
                "Image mean, red, green, blue": ", ".join(f"{d:+.3%}" for d in n.mean_difference),
            }
        rows["Time, raytrace2"] = f"{self.seconds:.3g} s"
        rows["Time, Mitsuba"] = f"{self.reference_seconds:.3g} s"
        return rows

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Writes the HTML page; see :func:`raytrace2.reference.report.write_report`."""
        noise = self.noise
        return write_report(
            path,
            ours=self.ours,
            reference=self.reference,
            title=self.title,
            figures=self.figures(),
            settings=self.settings,
            consistent=self.consistent,
            reasons=noise.reasons if noise is not None else (),
            flip_map=self.flip_map,
            z=None if noise is None else noise.z[..., 3],
            worst_tile=None if noise is None else noise.worst_tile,
        )

    def _repr_html_(self) -> str:
        images = "".join(
            f'<figure style="margin:0"><img alt="{name}" src="{png_uri(srgb_bytes(image))}" style="max-width:100%">'
            f"<figcaption>{name}</figcaption></figure>"
            for name, image in (("raytrace2", self.ours), ("Mitsuba", self.reference))
        )
        left = 'style="text-align:left"'
        rows = "".join(
            f"<tr><th {left}>{html.escape(k)}</th><td {left}>{html.escape(v)}</td></tr>"
            for k, v in self.figures().items()
        )
        reasons = "".join(f"<br>{html.escape(r)}" for r in (() if self.noise is None else self.noise.reasons))
        said = {None: "", True: "The difference is no more than noise.", False: "The images differ by more than noise:"}
        return (
            f"<p><b>{html.escape(self.title)}</b><br>{said[self.consistent]}{reasons}</p>"
            f'<div style="display:flex;gap:1em;flex-wrap:wrap">{images}</div><table>{rows}</table>'
        )


def compare_batches(
    ours: npt.ArrayLike,
    reference: npt.ArrayLike,
    *,
    title: str,
    seconds: float,
    reference_seconds: float,
    settings: Mapping[str, str] | None = None,
    noise_reference: npt.ArrayLike | None = None,
    false_alarm_rate: float = 1e-3,
) -> Comparison:
    """Compares batch means (B, H, W, 3) of ours with the reference's.

    The noise test wants batches of one size. When the reference was rendered with more samples in each, pass as
    ``noise_reference`` batches of Mitsuba's that have as many as ours; metrics and pictures still use ``reference``.
    With fewer than 8 batches on either side the noise test is left out.
    """
    a, b = np.asarray(ours, dtype=np.float32), np.asarray(reference, dtype=np.float32)
    fair = b if noise_reference is None else np.asarray(noise_reference, dtype=np.float32)
    noise = ztest(a, fair, false_alarm_rate=false_alarm_rate) if min(len(a), len(fair)) >= 8 else None
    image, target = (v.mean(axis=0, dtype=np.float64).astype(np.float32) for v in (a, b))
    error, flip_map = flip(image, target)
    return Comparison(
        title=title,
        ours=image,
        reference=target,
        rmse=rmse(image, target),
        relmse=relmse(image, target),
        mae=mae(image, target),
        psnr=psnr(image, target),
        flip=error,
        flip_map=flip_map.astype(np.float32),
        seconds=seconds,
        reference_seconds=reference_seconds,
        noise=noise,
        settings=dict(settings or {}),
    )
