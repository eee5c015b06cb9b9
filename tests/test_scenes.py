"""Scenes of the demo: each writes a bag, a picture and an animation."""

import numpy as np
import pytest
from PIL import Image
from via_bringup.demo import animations, scenes
from via_core.bags.reader import read_bag
from via_core.errors import ParameterError
from via_core.hopper import Hopper


def test_an_unknown_scene_is_refused(tmp_path):
    with pytest.raises(ParameterError, match="no scene 'dance'; there are: limit-cycle, hitting, hopper, throw"):
        scenes.run_scene("dance", tmp_path, 1.0, print)


def test_the_hoppers_feet_are_below_its_hips_in_a_crouch():
    robot = Hopper()
    a = 0.6
    trunk, front, rear = animations.skeleton(robot, np.array([0.0, 0.5, 0.0]), np.array([a, -2.0 * a, -a, 2.0 * a]))
    assert trunk == pytest.approx(np.array([[0.25, 0.5], [-0.25, 0.5]]))
    for leg, side in ((front, 1.0), (rear, -1.0)):
        assert leg[2] == pytest.approx([0.25 * side, 0.5 - 0.5 * np.cos(a)])  # two segments of .25 m
        assert side * leg[1, 0] > 0.25  # mirrored knees point away from each other


def test_the_throw_writes_a_bag_a_picture_and_an_animation(tmp_path, monkeypatch):
    monkeypatch.setattr(animations, "FRAMES", 2)
    bag, drawn, moving = scenes.run_scene("throw", tmp_path / "throw", 1.0, print)
    states = read_bag(bag)["/visco_elastic_demo/control"]
    link = np.array(list(states["value"]))[:, list(states["name"][0]).index("link_velocity")]
    assert link.max() > 4.0  # four times the speed limit of its motor
    assert drawn.stat().st_size > 10_000
    with Image.open(moving) as animation:
        assert animation.n_frames > 5


def test_the_limit_cycle_writes_a_bag_a_picture_and_an_animation(tmp_path, monkeypatch):
    monkeypatch.setattr(animations, "FRAMES", 5)
    bag, picture, moving = scenes.run_scene("limit-cycle", tmp_path, 0.6, print)
    assert len(read_bag(bag).topic("/joint_states")) >= 600
    assert picture.stat().st_size > 10_000
    with Image.open(moving) as animation:
        assert animation.n_frames >= 2


def test_the_hopper_bag_contains_the_motion_of_the_trunk(tmp_path, monkeypatch):
    monkeypatch.setattr(animations, "FRAMES", 5)
    bag, _, moving = scenes.run_scene("hopper", tmp_path, 0.4, print)
    base = read_bag(bag)["/hopper/base"]
    height = base["pose.position.z"]
    assert len(height) >= 400 and height[0] - height.min() > 0.03  # it falls and bends its legs
    level = np.hypot(base["pose.orientation.y"], base["pose.orientation.w"])
    assert level == pytest.approx(np.ones(len(height))) and np.abs(base["pose.orientation.y"]).max() < 0.05
    with Image.open(moving) as animation:
        assert animation.n_frames >= 2
