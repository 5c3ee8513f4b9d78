"""Message-path syntax, as Foxglove writes it."""

import pytest

from bodylog.errors import ConfigError
from bodylog.logs.decode.message_path import IndexRange, Only, Path, parse_message_path, parse_steps


@pytest.mark.parametrize(
    ("text", "topic", "expected"),
    [
        ("/joint_states", "/joint_states", ()),
        ("/joint_states.position[0]", "/joint_states", ("position", IndexRange(0, 0))),
        ("/skin.data[:].prox[0]", "/skin", ("data", IndexRange(0, -1), "prox", IndexRange(0, 0))),
        ("/a/b.c[1:3]", "/a/b", ("c", IndexRange(1, 3))),
        ("/a.c[-1]", "/a", ("c", IndexRange(-1, -1))),
        ("/a.c[2:]", "/a", ("c", IndexRange(2, -1))),
        ("/a.c[:]{id==2}.x", "/a", ("c", IndexRange(0, -1), Only("id", 2), "x")),
        ('/a.c[:]{name=="left arm"}', "/a", ("c", IndexRange(0, -1), Only("name", "left arm"))),
        ("/a.c{on==true}", "/a", ("c", Only("on", 1))),
        ("io_teleop/joint_states", "io_teleop/joint_states", ()),
    ],
)
def test_parse_splits_topic_and_steps(text, topic, expected):
    assert parse_message_path(text) == Path(topic, expected)


def test_parse_prefers_a_known_topic_with_dots():
    assert parse_message_path("/cam.left.data", ["/cam", "/cam.left"]) == Path("/cam.left", ("data",))


def test_steps_accept_a_missing_first_dot():
    assert parse_steps("data[:].prox[0]") == parse_steps(".data[:].prox[0]")


@pytest.mark.parametrize("text", ["/a.", "/a.b[", "/a.b[x]", "/a.b{id=2}", "/a.b..c", "/a.b[1:2:3]"])
def test_parse_names_the_invalid_part(text):
    with pytest.raises(ConfigError, match="cannot read"):
        parse_message_path(text)


@pytest.mark.parametrize(
    ("span", "picked"),
    [
        (IndexRange(1, 2), [1, 2]),
        (IndexRange(0, -1), [0, 1, 2, 3]),
        (IndexRange(-2, -1), [2, 3]),
        (IndexRange(3, 9), [3]),
        (IndexRange(7, 9), []),
        (IndexRange(-9, 1), [0, 1]),
    ],
)
def test_index_range_includes_both_ends(span, picked):
    assert list(span.of(4)) == picked
