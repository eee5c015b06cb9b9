"""Scenes: what they draw lies there and moves; an arm's comes from the bag that its nodes left."""

import numpy as np
import pytest
from PIL import Image
from via_bringup.demo import scenes
from via_core.bags.reader import read_bag
from via_core.errors import ParameterError
from via_core.hopper import Hopper


def test_a_scene_that_is_not_there(tmp_path):
    with pytest.raises(ParameterError, match="no scene 'dance'; there are: limit-cycle, hitting, hopper, throw"):
        scenes.play("dance", tmp_path, 1.0)


def test_the_hoppers_feet_are_below_its_hips_when_it_crouches():
    robot = Hopper()
    a = 0.6
    trunk, front, rear = scenes.skeleton(robot, np.array([0.0, 0.5, 0.0]), np.array([a, -2.0 * a, -a, 2.0 * a]))
    assert trunk == pytest.approx(np.array([[0.25, 0.5], [-0.25, 0.5]]))
    for leg, side in ((front, 1.0), (rear, -1.0)):
        assert leg[2] == pytest.approx([0.25 * side, 0.5 - 0.5 * np.cos(a)])  # two segments of .25 m
        assert side * leg[1, 0] > 0.25  # mirrored knees point away from each other


def test_a_throw_is_drawn_and_moves(tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "FRAMES", 2)
    bag, drawn, moving = scenes.play("throw", tmp_path / "throw", 1.0)
    states = read_bag(bag)["/visco_elastic_demo/control"]
    link = np.array(list(states["value"]))[:, list(states["name"][0]).index("link_velocity")]
    assert link.max() > 4.0  # four times as fast as its motor can be
    assert drawn.stat().st_size > 10_000
    with Image.open(moving) as animation:
        assert animation.n_frames > 5


def test_the_arms_scene_leaves_a_bag_a_picture_and_an_animation(tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "FRAMES", 5)
    bag, picture, moving = scenes.play("limit-cycle", tmp_path, 0.6)
    assert len(read_bag(bag).topic("/joint_states")) >= 600
    assert picture.stat().st_size > 10_000
    with Image.open(moving) as animation:
        assert animation.n_frames >= 2


def test_the_hoppers_scene_knows_its_trunk_from_the_bag(tmp_path, monkeypatch):
    monkeypatch.setattr(scenes, "FRAMES", 5)
    bag, _, moving = scenes.play("hopper", tmp_path, 0.4)
    base = read_bag(bag)["/hopper/base"]
    height = base["pose.position.z"]
    assert len(height) >= 400 and height[0] - height.min() > 0.03  # it fell, and bends its legs
    level = np.hypot(base["pose.orientation.y"], base["pose.orientation.w"])
    assert level == pytest.approx(np.ones(len(height))) and np.abs(base["pose.orientation.y"]).max() < 0.05
    with Image.open(moving) as animation:
        assert animation.n_frames >= 2
