from __future__ import annotations

import io
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from raytrace2.errors import FileError
from raytrace2.image_io import (
    linear_to_srgb,
    read_exr_channels,
    read_image,
    srgb_to_linear,
    write_exr,
    write_png,
)


@pytest.fixture(scope="module")
def mi():
    import raytrace2  # noqa: F401  (settles libLLVM)

    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("llvm_ad_rgb")
    return mitsuba


def require_same_as_mitsuba(mi, path: Path) -> None:
    for raw in (False, True):
        texture = mi.load_dict({"type": "bitmap", "filename": str(path), "raw": raw})
        theirs = np.array(mi.traverse(texture)["data"])
        pixels, is_srgb_encoded = read_image(path, raw=raw)
        assert pixels.dtype == theirs.dtype and pixels.shape == theirs.shape
        assert is_srgb_encoded == (pixels.dtype == np.uint8 and not raw)
        if pixels.dtype == np.uint8 or raw:
            np.testing.assert_array_equal(pixels, theirs)
        else:  # the sRGB curve may round to the next half
            np.testing.assert_allclose(pixels.astype(float), theirs, rtol=1e-3)


def picture(channels: int, dtype: str = "u1") -> np.ndarray:
    rng = np.random.default_rng(channels)
    size = (13, 17, channels)
    if dtype[0] == "f":
        return rng.random(size).astype(dtype)
    return rng.integers(0, np.iinfo(dtype).max, size, endpoint=True).astype(dtype)


@pytest.mark.parametrize(
    ("suffix", "mode"),
    [("png", mode) for mode in ("L", "LA", "RGB", "RGBA", "P", "1")]
    + [("jpg", "L"), ("jpg", "RGB"), ("bmp", "L"), ("bmp", "RGB"), ("ppm", "RGB")]
    + [("tga", "L"), ("tga", "RGB"), ("tga", "RGBA")],
)
def test_8_bit_images_agree_with_mitsuba(mi, tmp_path, suffix, mode):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(picture(4)).convert(mode).save(path)
    require_same_as_mitsuba(mi, path)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_16_bit_png_agrees_with_mitsuba(mi, tmp_path, channels):
    formats = mi.Bitmap.PixelFormat
    path = tmp_path / "a.png"
    pixel_format = (formats.Y, formats.YA, formats.RGB, formats.RGBA)[channels - 1]
    bitmap = mi.Bitmap(picture(channels, "u2"), pixel_format=pixel_format)
    bitmap.set_srgb_gamma(True)
    bitmap.write(str(path))
    assert path.read_bytes()[24] == 16
    require_same_as_mitsuba(mi, path)


@pytest.mark.parametrize("dtype", ["f2", "f4"])
@pytest.mark.parametrize("names", ["R G B", "R G B A", "Y", "Y A", "a.R a.G a.B"])
def test_exr_agrees_with_mitsuba(mi, tmp_path, dtype, names):
    path = tmp_path / "a.exr"
    channels = names.split()
    write_exr(path, picture(len(channels), dtype), channels)
    require_same_as_mitsuba(mi, path)


def test_exr_keeps_channels_and_provenance(tmp_path):
    path = tmp_path / "a.exr"
    image = picture(5, "f4")
    image[2, 3] = (np.nan, np.inf, -np.inf, -0.0, 1e-42)
    names = ["R", "G", "B", "depth.T", "albedo.R"]
    metadata = {"raytrace2.scene": "0123abcd", "raytrace2.seconds": "1.25", "comments": "grüß", "empty": ""}
    write_exr(path, image, names, metadata)
    channels, strings = read_exr_channels(path)
    assert set(channels) == set(names) and metadata.items() <= strings.items()
    for i, name in enumerate(names):
        np.testing.assert_array_equal(channels[name], image[:, :, i])
        assert channels[name].dtype == np.float32
    write_exr(path, image[:, :, 0].astype(np.float16), ["Y"])
    assert read_exr_channels(path)[0]["Y"].dtype == np.float16
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]


def test_what_cannot_be_written_is_refused_and_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.exr"
    path.write_bytes(b"old")
    image = picture(3, "f4")
    for bad in (
        lambda: write_exr(path, image, ["R", "G"]),
        lambda: write_exr(path, image, ["R", "G", "R"]),
        lambda: write_exr(path, image[:0], ["R", "G", "B"]),
        lambda: write_exr(path, image, ["R", "G", "B"], {"channels": "x"}),
        lambda: write_exr(path, image, ["R", "G", "B"], {"chromaticities": "x"}),
        lambda: write_exr(path, image, ["R", "G", "B"], {"seconds": 1.5}),  # type: ignore[dict-item]
        lambda: write_png(path, picture(2, "f4")),
    ):
        with pytest.raises(ValueError, match="."):
            bad()
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(FileError, match="cannot be written"):
        write_exr(tmp_path / "missing" / "a.exr", image, ["R", "G", "B"])
    with pytest.raises(FileError, match="cannot be written"):
        write_png(tmp_path, image)
    assert len(list(tmp_path.iterdir())) == 1


def test_png_shows_what_is_not_finite(tmp_path):
    path = tmp_path / "a.png"
    image = np.full((2, 3, 3), 0.5)
    image[0] = [[-1, 0, 1], [2, 0.0031308, 0.18], [np.nan, 0, 0]]
    image[1, 0, 1] = np.inf
    write_png(path, image)
    with Image.open(path) as written:
        levels = np.asarray(written)
    assert levels[0].tolist() == [[0, 0, 255], [255, 10, 118], [255, 0, 255]]
    assert levels[1].tolist() == [[255, 0, 255], [188] * 3, [188] * 3]
    write_png(path, np.full((2, 2), 0.5))
    assert read_image(path).pixels.tolist() == [[[188] * 3] * 2] * 2
    write_png(path, np.full((1, 1, 4), 0.5))
    with Image.open(path) as written:
        assert np.asarray(written).tolist() == [[[188, 188, 188, 128]]]


def test_srgb_curves_invert_each_other():
    x = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(x)), x, atol=1e-7)
    np.testing.assert_allclose(srgb_to_linear(np.array([0, 1, 128, 255]) / 255), [0, 1 / 255 / 12.92, 0.21586050, 1])


def refuse(path: Path, data: bytes, words: str, read=read_image) -> None:
    path.write_bytes(data)
    with pytest.raises(FileError, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value) and caught.value.problem.remedy and "\n" not in str(caught.value)


def png(size: tuple[int, int] = (64, 48)) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)).save(stream, "PNG")
    return stream.getvalue()


def exr(header: dict, channels: dict[str, np.ndarray]) -> bytes:
    stream = io.BytesIO()
    standard = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(standard | header, channels) as file:
        file.write(stream)
    return stream.getvalue()


def test_bad_images_are_refused(tmp_path):
    path = tmp_path / "bad"
    refuse(path, b"", "no image of a known format")
    refuse(path, b"hello", "no image of a known format")
    refuse(path, png()[:3000], "cannot be decoded")
    header = b"IHDR" + struct.pack(">II", 60000, 60000) + b"\x08\x02\0\0\0"
    bomb = png()[:8] + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    refuse(path, bomb + png()[33:], "too many pixels")
    refuse(path, b"#?RADIANCE\n", "Radiance HDR")
    refuse(path, b"PF\n1 1\n-1\n" + bytes(12), "PFM")
    refuse(path, b"P6\n1 1\n65535\n" + bytes(6), "more than 8 bits")
    cmyk = io.BytesIO()
    Image.fromarray(picture(4), "CMYK").save(cmyk, "JPEG")
    refuse(path, cmyk.getvalue(), "mode CMYK")
    with pytest.raises(FileError, match="no such file"):
        read_image(tmp_path / "missing.png")


def test_exr_that_is_no_texture_is_refused(tmp_path):
    path = tmp_path / "bad.exr"
    y = picture(1, "f4")[:, :, 0]
    refuse(path, exr({}, {"G": y}), "channels G")
    refuse(path, exr({}, {c: y for c in "RGBZ"}), "channels")
    refuse(path, exr({}, {c: y for c in "XYZ"}), "channels")
    refuse(path, exr({}, {"a.R": y, "b.G": y, "b.B": y}), "channels")
    refuse(path, exr({}, {"Y": np.ones((4, 4), np.uint32)}), "integers")
    refuse(path, exr({"chromaticities": (0.7, 0.3, 0.2, 0.7, 0.1, 0.05, 0.33, 0.33)}, {"Y": y}), "primaries")
    y[3, 5] = np.inf
    refuse(path, exr({}, {"Y": y}), r"pixel \(5, 3\) is not finite")


def test_exr_headers_are_held_against_the_file(tmp_path):
    path = tmp_path / "bad.exr"
    good = exr({}, {"Y": picture(1, "f4")[:, :, 0]})
    refuse(path, good[:100], "damaged", read_exr_channels)
    refuse(path, good[:-50], "OpenEXR cannot read", read_exr_channels)
    for bit, words in ((0x800, "deep"), (0x1000, "several parts"), (1, "version")):
        version = struct.unpack_from("<I", good, 4)[0] ^ bit
        refuse(path, good[:4] + struct.pack("<I", version) + good[8:], words, read_exr_channels)
    at = good.index(b"dataWindow\0box2i\0") + 21
    refuse(path, good[:at] + struct.pack("<4i", 0, 0, 99999, 99999) + good[at + 16 :], "speaks of", read_exr_channels)
    refuse(path, good[:at] + struct.pack("<4i", 0, 0, -5, 9) + good[at + 16 :], "empty", read_exr_channels)


SEEDS = [png((9, 7)), exr({}, {c: picture(1, "f4")[:, :, 0] for c in "RGB"}), exr({}, {"Y": picture(1, "f2")[:, :, 0]})]


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_images_give_pixels_or_a_file_error(tmp_path, data):
    changed = bytearray(data.draw(st.sampled_from(SEEDS)))
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged"
    path.write_bytes(bytes(changed[: data.draw(st.integers(0, len(changed)))] if data.draw(st.booleans()) else changed))
    try:
        pixels, _ = read_image(path)
    except FileError as error:
        assert "\n" not in str(error)
        return
    assert pixels.ndim == 3 and pixels.shape[2] in (1, 3) and pixels.dtype in (np.uint8, np.float16, np.float32)


@pytest.mark.skipif("RAYTRACE2_MITSUBA_DATA" not in os.environ, reason="RAYTRACE2_MITSUBA_DATA names no folder")
def test_textures_of_the_mitsuba_gallery(mi):
    for path in sorted((Path(os.environ["RAYTRACE2_MITSUBA_DATA"]) / "common" / "textures").iterdir()):
        require_same_as_mitsuba(mi, path)
