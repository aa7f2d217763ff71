"""Texture filters and differentials as settings of a render, and what they change about samples and the film."""

import numpy as np
import pytest

import raytrace2 as rt
from raytrace2.filtering import plan_filtering
from raytrace2.scene.description import Film, ReconstructionFilter

CHECKS = (np.indices((16, 16)).sum(axis=0) % 2)[..., None].astype(np.float32)


def floor(**settings) -> rt.Scene:
    """A grazing floor that shines with checks, through a Gaussian."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    ScalarTransform4f = mi.ScalarTransform4f
    checks = {"type": "bitmap", "bitmap": mi.Bitmap(CHECKS), "raw": True, "to_uv": ScalarTransform4f().scale([8, 8, 1])}
    return rt.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 1},
            "sensor": {
                "type": "perspective",
                "to_world": ScalarTransform4f().look_at([0, -1, 0.2], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 24, "height": 24, "rfilter": {"type": "gaussian"}},
                "sampler": {"type": "multijitter", "sample_count": 16},
            },
            "floor": {"type": "rectangle", "emitter": {"type": "area", "radiance": checks}},
        },
        **settings,
    )


def picture(scene: rt.Scene, **options) -> np.ndarray:
    return np.array(rt.render(scene, **options))


@pytest.mark.parametrize("name", [n for n in rt.filter_names() if n != "nearest"])
def test_every_filter_renders_and_those_of_footprints_come_near_the_truth(name):
    scene = floor()
    truth = picture(scene, spp=1024)
    found = picture(scene, filter=name)
    assert np.isfinite(found).all()
    covered = truth.sum(axis=2) > 0.2

    def distance(image: np.ndarray) -> float:
        return float(np.sqrt(np.square(image - truth)[covered].mean()))

    if name in ("trilinear", "ewa", "probes", "exact", "exact2"):
        assert distance(found) < 0.6 * distance(picture(scene, filter="bilinear"))


@pytest.mark.parametrize("differentials", ["distance", "cone", "finite", "analytic", "autodiff", "autodiff2"])
def test_differentials_by_name(differentials):
    scene = floor()
    found = picture(scene, filter="ewa", differentials=differentials)
    assert np.isfinite(found).all()
    if differentials not in ("distance", "cone"):
        np.testing.assert_allclose(found, picture(scene, filter="ewa"), atol=0.05)


def test_one_sample_stands_for_its_pixel():
    film = Film(8, 8, rfilter=ReconstructionFilter("gaussian"))
    one, many = plan_filtering("ewa", None, film, 1), plan_filtering("ewa", None, film, 4)
    assert one.centred and one.film.rfilter.name == "box" and one.textures.pixel.name == "gaussian"
    assert not many.centred and many.film.rfilter.name == "gaussian" and many.textures.pixel.name == "box"
    assert one.differentials == "autodiff" and plan_filtering("mip_distance", None, film, 1).differentials == "distance"
    plain = plan_filtering("bilinear", None, film, 1)
    assert not plain.centred and plain.differentials == "none" and plain.film is film


def test_the_same_image_to_the_bit():
    scene = floor()
    np.testing.assert_array_equal(picture(scene, filter="exact"), picture(scene, filter="exact"))


def test_a_scene_can_choose():
    chosen = floor(settings={"filter": "trilinear", "differentials": "cone"})
    wanted = picture(floor(), filter="trilinear", differentials="cone")
    np.testing.assert_array_equal(picture(chosen), wanted)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"filter": "mean"}, "unknown filter 'mean'; there are nearest, bilinear"),
        ({"filter": "ewa:size=3"}, "'size=3' is no option"),
        ({"filter": "ewa:max_anisotropy=0.5"}, "max_anisotropy must be 1 or more"),
        ({"filter": "ewa", "differentials": "none"}, "filter 'ewa' needs footprints"),
        ({"differentials": "exact"}, "unknown differentials 'exact'; there are none, "),
    ],
)
def test_what_does_not_exist_is_refused(options, said):
    with pytest.raises(rt.SettingError, match=said):
        rt.render(floor(), **options)
