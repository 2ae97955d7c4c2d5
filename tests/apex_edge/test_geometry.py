import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apex_edge.geometry import camera_matrix, look_at, on_plane, project, rays
from apex_edge.types import CameraModel

EYE = (0.60, 0.0, 0.55)
AIM = (0.20, 0.0, 0.0)
TABLE_X = st.floats(-0.05, 0.45)
TABLE_Y = st.floats(-0.25, 0.25)
HEIGHT = st.floats(0.0, 0.06)


def make_camera(eye=EYE, aim=AIM, dist=(0.0, 0.0, 0.0, 0.0, 0.0)):
    pose = look_at(np.array(eye), np.array(aim))
    return CameraModel(640, 480, 560.0, 560.0, 320.0, 240.0, np.array(dist), pose)


def test_aim_point_is_seen_at_the_principal_point():
    pixels, depth = project(make_camera(), np.array([AIM]))
    np.testing.assert_allclose(pixels, [[320.0, 240.0]], atol=1e-9)
    np.testing.assert_allclose(depth, [np.linalg.norm(np.subtract(EYE, AIM))])


def test_picture_is_upright_and_not_mirrored():
    # the camera looks back at the arm: the table's left is the picture's right, high is up
    pixels, _ = project(make_camera(), np.array([[0.2, 0.1, 0.0], [0.2, 0.0, 0.1]]))
    assert pixels[0, 0] > 320.0
    assert pixels[1, 1] < 240.0


@given(
    st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1)),
    st.tuples(TABLE_X, TABLE_Y),
)
def test_pose_is_always_a_rigid_motion(eye, aim):
    pose = look_at(np.array(eye), np.array([aim[0], aim[1] + 3.0, 0.0]))
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])
    np.testing.assert_array_equal(pose[:3, 3], eye)


@pytest.mark.parametrize("aim", [(0.1, 0.2, 0.0), (0.1, 0.2, 0.5)])
def test_view_straight_down_or_nowhere_is_refused(aim):
    with pytest.raises(ValueError, match="vertical or zero"):
        look_at(np.array([0.1, 0.2, 0.5]), np.array(aim))


@given(TABLE_X, TABLE_Y, HEIGHT)
def test_point_to_pixel_and_back_to_its_plane_is_the_point(x, y, z):
    camera, point = make_camera(), np.array([[x, y, z]])
    pixels, _ = project(camera, point)
    np.testing.assert_allclose(on_plane(camera, pixels, z), point, atol=1e-9)


@given(TABLE_X, TABLE_Y, HEIGHT)
def test_round_trip_holds_with_lens_distortion(x, y, z):
    camera = make_camera(dist=(-0.12, 0.05, 0.001, -0.001, 0.0))
    point = np.array([[x, y, z]])
    pixels, _ = project(camera, point)
    np.testing.assert_allclose(on_plane(camera, pixels, z), point, atol=1e-5)


@given(TABLE_X, TABLE_Y, HEIGHT)
def test_ray_times_depth_from_the_eye_is_the_point(x, y, z):
    camera, point = make_camera(), np.array([[x, y, z]])
    pixels, depth = project(camera, point)
    eye = camera.table_from_cam[:3, 3]
    np.testing.assert_allclose(eye + depth[:, None] * rays(camera, pixels), point, atol=1e-9)


def test_distortion_moves_pixels_off_the_centre_only():
    straight, bent = make_camera(), make_camera(dist=(-0.12, 0.0, 0.0, 0.0, 0.0))
    points = np.array([AIM, (0.2, 0.2, 0.0)])
    moved = np.linalg.norm(project(straight, points)[0] - project(bent, points)[0], axis=1)
    assert moved[0] < 1e-6
    assert moved[1] > 1.0


def test_point_behind_the_camera_has_no_pixel():
    pixels, depth = project(make_camera(), np.array([[1.5, 0.0, 1.5], AIM]))
    assert depth[0] < 0.0
    assert np.isnan(pixels[0]).all()
    assert np.isfinite(pixels[1]).all()


def test_ray_above_the_horizon_never_meets_the_table():
    camera = make_camera(eye=(0.6, 0.0, 0.3), aim=(0.2, 0.0, 0.25))
    points = on_plane(camera, np.array([[320.0, 0.0], [320.0, 470.0]]), 0.0)
    assert np.isnan(points[0]).all()
    assert np.isfinite(points[1]).all()


def test_each_pixel_may_have_its_own_height():
    camera = make_camera()
    points = np.array([[0.1, 0.05, 0.0], [0.2, -0.1, 0.03]])
    pixels, _ = project(camera, points)
    np.testing.assert_allclose(on_plane(camera, pixels, points[:, 2]), points, atol=1e-9)


def test_camera_matrix_has_focal_lengths_and_centre():
    np.testing.assert_array_equal(
        camera_matrix(make_camera()), [[560, 0, 320], [0, 560, 240], [0, 0, 1]]
    )
