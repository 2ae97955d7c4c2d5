"""What the twin's camera sees agrees with the world it looks at."""

import numpy as np
import pytest

from apex_edge.geometry import on_plane, project
from apex_edge.twin.palette import PALETTE, SURROUNDINGS
from apex_edge.twin.render import Renderer, render
from apex_edge.twin.scene import Scenario, SceneObject
from apex_edge.twin.sensor import SATURATED, Sensor, SensorConfig
from apex_edge.twin.view import twin_camera_model
from apex_edge.twin.world import TwinWorld

CAMERA = twin_camera_model()
CLEAN = SensorConfig(
    gain_sd=0.0, colour_noise=0.0, depth_noise_m=0.0, edge_holes=0.0, holes=0.0, glare=0.0
)
ARM = np.array([(0.0, 0.0, 0.09), (0.05, 0.0, 0.1), (0.12, 0.0, 0.09), (0.17, 0.0, 0.005)])


def item(colour="green", kind="ball", at=(0.25, 0.05), vel=(0.0, 0.0), yaw=0.4, look="plain"):
    radius = 0.015 if kind == "ball" else 0.0175
    return SceneObject(f"{colour} {kind}", colour, kind, radius, at, vel, yaw, look=look)


def world_of(*objects):
    return TwinWorld(Scenario("many", 0, objects, (), 8.0, "", objects[0].name, False))


def renderer(config=CLEAN, seed=0):
    return Renderer(CAMERA, config, np.random.RandomState(seed))


def pixel_of(point_m):
    pixels, depth = project(CAMERA, np.array([point_m]))
    u, v = np.rint(pixels[0]).astype(int)
    return u, v, float(depth[0])


def chromaticity(bgr):
    bgr = np.asarray(bgr, dtype=float)
    return bgr / bgr.sum()


@pytest.mark.parametrize("colour", sorted(PALETTE))
@pytest.mark.parametrize("kind", ["ball", "block"])
def test_centre_of_an_object_has_its_palette_colour(colour, kind):
    world = world_of(item(colour, kind))
    u, v, _ = pixel_of(world.objects.pos_m[0])
    bgr, _ = renderer().render(world.state())
    seen = bgr[v - 2 : v + 3, u - 2 : u + 3].reshape(-1, 3).mean(axis=0)
    distances = {
        name: np.linalg.norm(chromaticity(seen) - chromaticity(value))
        for name, value in {**PALETTE, **SURROUNDINGS}.items()
    }
    assert min(distances, key=distances.get) == colour
    assert distances[colour] < 0.05


def test_visible_surface_is_as_bright_as_the_palette_says_on_average():
    ratios, eye = [], renderer()
    for colour in PALETTE:
        for kind in ("ball", "block"):
            world = world_of(item(colour, kind))
            bgr, _ = eye.paint(world.state())
            u, v, _ = pixel_of(world.objects.pos_m[0])
            window = bgr[v - 4 : v + 5, u - 4 : u + 5].reshape(-1, 3)
            ratios.append(window.sum() / (len(window) * sum(PALETTE[colour])))
    assert 0.85 < np.mean(ratios) < 1.15
    assert min(ratios) > 0.65


def test_depth_at_a_balls_centre_is_its_near_side():
    world = world_of(item("green", "ball"))
    u, v, depth = pixel_of(world.objects.pos_m[0])
    _, depth_mm = renderer().render(world.state())
    # The ray through the centre leaves the ball one radius nearer, along the ray.
    ray = np.linalg.norm(world.objects.pos_m[0] - CAMERA.table_from_cam[:3, 3])
    expected = depth * (1.0 - 0.015 / ray) * 1000.0
    assert depth_mm[v, u] == pytest.approx(expected, abs=1.5)


def test_depth_of_a_blocks_top_is_its_plane():
    world = world_of(item("red", "block"))
    top = world.objects.pos_m[0] + (0.0, 0.0, 0.0175)
    u, v, depth = pixel_of(top)
    _, depth_mm = renderer().render(world.state())
    assert depth_mm[v, u] == pytest.approx(depth * 1000.0, abs=2.0)


def test_depth_of_the_bare_table_gives_back_the_table_plane():
    world = world_of(item(at=(0.0, 0.3)))
    _, depth_mm = renderer().render(world.state())
    for u, v in ((320, 300), (150, 350), (500, 200)):
        ground = on_plane(CAMERA, np.array([[u, v]]), 0.0)
        _, depth = project(CAMERA, ground)
        assert depth_mm[v, u] == pytest.approx(depth[0] * 1000.0, abs=0.6)


def test_nearer_object_hides_the_one_behind_it():
    # The camera stands at x = 0.6: the block at the larger x hides part of the ball.
    ball, block = item("green", "ball", (0.2, 0.0)), item("red", "block", (0.238, 0.0), yaw=0.0)
    for objects in ((ball, block), (block, ball)):
        world = world_of(*objects)
        alone = renderer().paint(world_of(ball).state())[0]
        both = renderer().paint(world.state())[0]
        n_alone, n_both = (_count_green(picture) for picture in (alone, both))
        assert 0.05 * n_alone < n_both < 0.95 * n_alone


def _count_green(bgr):
    blue, green, red = (bgr[..., k].astype(int) for k in range(3))
    return int(((green > 1.5 * red) & (green > 1.5 * blue)).sum())


def test_arm_hides_what_lies_under_it_and_is_near_in_depth():
    world = world_of(item("red", "block", (0.10, 0.0)))
    before, depth_before = renderer().paint(world.state())
    world.set_arm(ARM)
    after, depth_after = renderer().paint(world.state())
    u, v, depth = pixel_of(ARM[2])
    assert depth_after[v, u] == pytest.approx(depth, abs=0.02)
    assert depth_after[v, u] < depth_before[v, u] - 0.02
    assert (depth_after <= depth_before).all()
    assert not np.array_equal(before, after)


def test_moving_ball_is_blurred_along_its_way():
    widths = []
    for speed in (0.0, 2.0):
        world = world_of(item("green", "ball", (0.25, 0.0), vel=(0.0, speed)))
        bgr, _ = renderer(SensorConfig(exposure_s=0.02)).paint(world.state())
        row = pixel_of(world.objects.pos_m[0])[1]
        bare, _ = renderer().paint(world_of(item("green", "ball", (-0.03, 0.38))).state())
        changed = np.abs(bgr[row].astype(int) - bare[row].astype(int))[:, 2] > 12
        widths.append(int(changed.sum()))
    assert widths[1] >= widths[0] + 20


def test_object_throws_a_shadow_on_the_table_only():
    state = world_of(item("green", "ball")).state()
    bgr, depth_m = renderer().paint(state)
    bare, bare_depth = renderer().paint(world_of(item("green", "ball", (-0.03, 0.38))).state())
    is_same_depth = (depth_m == bare_depth)[:, 40:]
    darker = (bgr.astype(int).sum(axis=2) < 0.85 * bare.astype(int).sum(axis=2))[:, 40:]
    assert 50 < (darker & is_same_depth).sum() < 3000


def test_depth_has_holes_and_saturated_patches():
    world = world_of(item("green", "ball"), item("red", "block", (0.12, 0.0)))
    eye = renderer(SensorConfig(glare=1.0))
    pictures = [eye.render(world.state())[1] for _ in range(6)]
    assert all((depth == 0).sum() > 100 for depth in pictures)
    n_saturated = sum(int((depth == SATURATED).sum()) for depth in pictures)
    assert 10 < n_saturated < 0.02 * 6 * pictures[0].size
    assert pictures[0].dtype == np.uint16
    hole_shares = [float((depth == 0).mean()) for depth in pictures]
    assert max(hole_shares) < 0.05


def test_depth_noise_has_the_set_size_and_grows_with_range():
    flat = np.full((200, 200), 0.7, np.float32)
    sds = []
    for range_m in (0.7, 1.4):
        config = SensorConfig(depth_noise_m=0.003, edge_holes=0.0, holes=0.0, glare=0.0)
        sensor = Sensor(config, flat.shape, np.random.RandomState(1))
        sds.append(float(sensor.measure(flat * np.float32(range_m / 0.7)).astype(float).std()))
    assert sds[0] == pytest.approx(3.0, rel=0.15)
    assert sds[1] == pytest.approx(12.0, rel=0.15)


def test_colour_noise_and_gain_have_the_set_size():
    grey = np.full((240, 320, 3), 100, np.uint8)
    config = SensorConfig(gain=1.3, gain_sd=0.0, colour_noise=5.0)
    seen = Sensor(config, grey.shape[:2], np.random.RandomState(2)).expose(grey).astype(float)
    assert seen.mean() == pytest.approx(130.0, abs=0.5)
    assert seen.std() == pytest.approx(5.0, rel=0.05)


def test_same_seed_gives_the_same_bytes_and_another_seed_does_not():
    world = world_of(item("green", "ball", vel=(0.0, 0.1)), item("red", "block", (0.12, 0.0)))
    runs = []
    for seed in (5, 5, 6):
        eye = renderer(SensorConfig(), seed)
        runs.append([part.tobytes() for _ in range(2) for part in eye.render(world.state())])
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_keeping_still_layers_does_not_change_the_picture():
    world = world_of(item("green", "ball", vel=(0.0, 0.1)), item("red", "block", (0.12, 0.0)))
    kept = renderer()
    for _ in range(4):
        world.set_arm(ARM)
        reused = kept.paint(world.state())
        fresh = renderer().paint(world.state())
        assert np.array_equal(reused[0], fresh[0])
        assert np.array_equal(reused[1], fresh[1])
        world.step(0.4)


@pytest.mark.parametrize("look", ["car", "child"])
def test_dressed_up_block_keeps_most_of_its_colour(look):
    plain = renderer().paint(world_of(item("green", "block")).state())[0]
    dressed = renderer().paint(world_of(item("green", "block", look=look)).state())[0]
    assert _count_green(plain) > _count_green(dressed) > 0.6 * _count_green(plain)


def test_camera_can_be_placed_and_sized_otherwise():
    camera = twin_camera_model(320, 240, 280.0, eye_m=(0.5, 0.1, 0.6), aim_m=(0.2, 0.0, 0.0))
    world = world_of(item("green", "ball"))
    bgr, depth_mm = render(world, camera, np.random.RandomState(0), CLEAN)
    assert bgr.shape == (240, 320, 3)
    assert depth_mm.shape == (240, 320)
    pixels, depth = project(camera, world.objects.pos_m)
    u, v = np.rint(pixels[0]).astype(int)
    assert depth_mm[v, u] == pytest.approx(1000.0 * depth[0] - 15.0, abs=2.0)


def test_lens_distortion_moves_object_and_projection_alike():
    plain = twin_camera_model()
    bent = plain.__class__(**{**plain.__dict__, "dist": np.array([-0.2, 0.05, 0.001, 0.0, 0.0])})
    world = world_of(item("green", "ball", (0.1, -0.25)))
    bgr, _ = render(world, bent, np.random.RandomState(0), CLEAN)
    pixels, _ = project(bent, world.objects.pos_m)
    u, v = np.rint(pixels[0]).astype(int)
    assert np.linalg.norm(pixels - project(plain, world.objects.pos_m)[0]) > 5.0
    assert _count_green(bgr[v - 3 : v + 4, u - 3 : u + 4]) == 49
