import ast
import json
import math
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodylog.body.gp.fit import samples_without_noise, train_gp
from bodylog.body.senses.encoder_function import Polynomial
from bodylog.body.storage import load_body, save
from bodylog.body_model import BodyModel, Noise, TouchConstants
from bodylog.errors import ModelError, OutputError


@pytest.fixture(scope="module")
def body() -> BodyModel:
    draw = np.random.default_rng(0)
    x = draw.uniform(-1, 1, (30, 2))
    y = np.column_stack([50 * np.sin(x[:, 0]), 40 * x[:, 1]]) + draw.normal(0, 0.1, (30, 2))
    gps = {name: train_gp(samples_without_noise(x, y), ("u", "v"), "px") for name in ("effector", "elbow/knob")}
    noise = Noise((1e-6, 2e-6), dict.fromkeys(gps, (0.01, 0.02)), (0.1, 0.2), {"encoder": (1e-7, 1e-7)})
    senses = {**gps, "encoders": Polynomial(("pan", "lift"), np.array([[0.0, 0.0, 1.0], [0.1, 2.0, 0.0]]))}
    touch, cells = TouchConstants(1.0, 0.003), {7: (0.5, -31.0, 9.0), 90: (1.0, 2.0, 3.0)}
    return BodyModel(("pan", "lift"), senses, noise, touch, {"logs": {"a.mcap": "ff"}}, cells)


def test_saving_and_loading_are_inverse(body: BodyModel, tmp_path: Path) -> None:
    save(body, tmp_path / "body.npz")
    found = load_body(tmp_path / "body.npz")
    for field in ("joints", "noise", "touch", "provenance", "cells"):
        assert getattr(found, field) == getattr(body, field)
    x = np.random.default_rng(1).uniform(-1, 1, (9, 2))
    for name, sense in body.senses.items():
        assert found.senses[name].outputs == sense.outputs and type(found.senses[name]) is type(sense)
        assert all(map(np.array_equal, found.senses[name].predict(x), sense.predict(x)))


def test_same_model_same_bytes_and_no_pickle(body: BodyModel, tmp_path: Path) -> None:
    one, other = tmp_path / "one.npz", tmp_path / "other.npz"
    save(body, one)
    save(load_body(one), other)
    assert one.read_bytes() == other.read_bytes()
    with np.load(one, allow_pickle=False) as arrays:
        assert all(arrays[name].dtype.kind in "fU" for name in arrays)


def _rewrite(change: Callable[[dict[str, np.ndarray]], None]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        with np.load(path) as found:
            arrays = {name: found[name] for name in found}
        change(arrays)
        np.savez(path, **arrays)

    return apply


def _header(**fields: object) -> Callable[[Path], None]:
    def change(arrays: dict[str, np.ndarray]) -> None:
        arrays["header"] = np.array(json.dumps(json.loads(str(arrays["header"])) | fields))

    return _rewrite(change)


def _set(name: str, value: object) -> Callable[[Path], None]:
    return _rewrite(lambda arrays: arrays.__setitem__(name, np.asarray(value)))


def _poison(name: str, value: float) -> Callable[[Path], None]:
    return _rewrite(lambda arrays: arrays[name].flat.__setitem__(0, value))


def _unclosed(path: Path) -> None:
    """An array with a truncated header, in a sound archive."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.npy", b"\x93NUMPY\1\0\x20\0" + b"{'descr': ('<U1',".ljust(32))


def _liar(path: Path) -> None:
    """A member whose header declares far more than the file holds."""
    with zipfile.ZipFile(path, "w") as archive, archive.open("header.npy", "w") as stream:
        np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (1 << 50,)})


def _shape(shape: str) -> Callable[[Path], None]:
    """The effector's weights with a header of another shape; the data's length is their product, if possible."""

    def change(path: Path) -> None:
        with zipfile.ZipFile(path) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
        data = bytes(8 * abs(math.prod(ast.literal_eval(shape))))
        members["effector/weights.npy"] = b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text.encode() + data
        with zipfile.ZipFile(path, "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)

    return change


def _text(old: str, new: str) -> Callable[[Path], None]:
    """The header's text with `old` replaced by what json.dumps would not write."""

    def change(arrays: dict[str, np.ndarray]) -> None:
        found = str(arrays["header"])
        assert found.count(old) == 1
        arrays["header"] = np.array(found.replace(old, new))

    return _rewrite(change)


_ERRORS = '"std_error": {"encoder": [1e-07, 1e-07]}'
_BROKEN = {
    "not a zip": (lambda p: p.write_bytes(b"hello"), "not a whole .npz file"),
    "truncated": (lambda p: p.write_bytes(p.read_bytes()[:-900]), "not a whole .npz file"),
    "flipped": (lambda p: p.write_bytes(p.read_bytes()[:3000] + b"\xff\x00" + p.read_bytes()[3002:]), "not a whole"),
    "bytes lost": (lambda p: p.write_bytes(p.read_bytes()[:1000] + p.read_bytes()[4000:]), "not a whole .npz file"),
    "unclosed": (_unclosed, "field header: not an array"),
    "liar": (_liar, "header: found float64"),
    "other arrays": (lambda p: np.savez(p, a=np.ones(3)), "field header: missing"),
    "other kind": (_header(kind="weights"), "field kind: not a bodylog body model"),
    "version": (_header(version=9), "field version: found 9, possible: 1"),
    "joints": (_header(joints=["pan"]), "field noise.encoder: found (1e-06, 2e-06), possible: 1 positive"),
    "more joints": (_header(joints=["a", "b", "c"]), "field noise.encoder"),
    "touch": (_header(touch={"a1": 1}), "field header: TouchConstants.__init__() missing"),
    "negative touch": (_header(touch={"a1": -1, "b1": 1}), "field touch: found {'a1': -1}"),
    "endless touch": (_text('"b1": 0.003', '"b1": 1e999'), "field touch: found {'b1': inf}, possible: finite"),
    "endless noise": (_text("[1e-06,", "[1e999,"), "noise.encoder: found [inf, 2e-06], possible: a list of fin"),
    "noise of text": (_text("[1e-06, 2e-06]", '"12"'), "noise.encoder: found 12, possible: a list of finite numbers"),
    "huge noise": (_text("[1e-06,", "[1" + 400 * "0" + ","), "noise.encoder: found [10000"),
    "error lengths": (_text(_ERRORS, '"std_error": {"encoder": [1.0]}'), "field noise.std_error.encoder: found (1.0,)"),
    "endless error": (_text(_ERRORS, '"std_error": {"encoder": [1, 1e999]}'), "noise.std_error.encoder: found [1, in"),
    "error of none": (_text(_ERRORS, '"std_error": {"nose": [1]}'), "field noise.std_error.nose: found (1.0,)"),
    "endless cell": (_text("[0.5, -31.0,", "[1e999, -31.0,"), "cells.7: found [inf, -31.0, 9.0], possible: a list"),
    "a joint twice": (_header(joints=["pan", "pan"]), "joints: found 'pan', possible: a list that names each"),
    "joints of text": (_header(joints="pl"), "joints: found pl, possible: a list of texts"),
    "wide": (_header(provenance={"image_width": "wide"}), "provenance.image_width: found 'wide', possible: 1 to"),
    "endless width": (_text('{"logs"', '{"image_width": 1e999, "logs"'), "provenance.image_width: found inf, possible"),
    "no width": (_header(provenance={"image_width": 0}), "provenance.image_width: found 0, possible: 1 to"),
    "shape": (_set("effector/weights", np.ones((2, 7))), "effector/weights: found shape (2, 7), possible: (2, 30)"),
    "type": (_set("effector/mean", np.array(["a", "b"])), "effector/mean: found <U1 (2,)"),
    "object": (lambda p: np.savez(p, header=np.array([{}], object)), "header"),
    "nan": (_poison("effector/factor", np.nan), "effector/factor: found nan, possible: numbers from -1e+30"),
    "infinite": (_poison("effector/weights", -np.inf), "effector/weights: found -inf, possible: numbers from -1e+30"),
    "scale": (_poison("effector/scales", -1.0), "effector/scales: found -1.0, possible: numbers from 1e-30"),
    "tiny scale": (_poison("effector/scales", 1e-300), "effector/scales: found 1e-300, possible: numbers from 1e-30"),
    "huge scale": (_poison("effector/scales", 1e300), "effector/scales: found 1e+300, possible: numbers from 1e-30"),
    "negative noise": (_poison("effector/noise", -1e-9), "effector/noise: found -1e-09, possible: numbers from 0"),
    "negative spread": (_poison("effector/spread", -1e-9), "effector/spread: found -1e-09, possible: numbers from 0"),
    "tiny noise": (_text("[1e-06,", "[1e-300,"), "noise.encoder: found (1e-300, 2e-06), possible: 2 positive"),
    "true noise": (_text("[1e-06,", "[true,"), "noise.encoder: found [True, 2e-06], possible: a list of finite"),
    "negative shape": (_shape("(-1, -2)"), "effector/weights: found float64 (-1, -2)"),
    "empty giant": (_shape("(0, 4611686018427387904, 8)"), "effector/weights: found float64 (0, 46116860184273"),
    "true shape": (_shape("(True, 2)"), "effector/weights: found float64 (True, 2)"),
    "held joint": (
        _header(provenance={"held": {"wrist": [0.1]}}),
        "provenance.held: found {'wrist': [0.1]}, possible: {joint: [low, high]}",
    ),
    "held joints": (_header(provenance={"held": 5}), "provenance.held: found 5, possible: {joint: [low, high]}"),
    "cameras": (_header(provenance={"cameras": 5}), "provenance.cameras: found 5, possible: a list of texts"),
    "deep": (_text('{"logs"', '{"x": ' + "[" * 900 + "]" * 900 + ', "logs"'), "field header: nested more than 64 deep"),
    "deeper": (_text('{"logs"', '{"x": ' + "[" * 9000 + "]" * 9000 + ', "logs"'), "field header: nested "),
    "degrees": (_header(units={"joints": "deg"}), "field units: found {'joints': 'deg'}, possible: {"),
    "no joints": (_header(joints=[]), "joints: found [], possible: a list that names each"),
}


@pytest.mark.parametrize("kind", _BROKEN)
def test_load_refuses_a_broken_model_by_name(kind: str, body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    save(body, path)
    damage, expected = _BROKEN[kind]
    damage(path)
    with pytest.raises(ModelError) as caught:
        load_body(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)
    assert expected in str(caught.value)


@pytest.mark.parametrize("seed", range(40))
def test_load_detects_every_flipped_byte(seed: int, body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    save(body, path)
    whole, draw = bytearray(path.read_bytes()), np.random.default_rng(seed)
    whole[draw.integers(len(whole))] ^= 1 << draw.integers(8)
    path.write_bytes(bytes(whole))
    try:
        found = load_body(path)
    except ModelError:
        return
    # a changed date or padding byte does not change the model
    assert found.joints == body.joints and found.noise == body.noise
    x = np.random.default_rng(1).uniform(-1, 1, (5, 2))
    assert all(np.array_equal(found.senses[n].predict(x)[0], g.predict(x)[0]) for n, g in body.senses.items())


def test_storage_names_a_missing_file_and_folder(body: BodyModel, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="there is no such body model"):
        load_body(tmp_path / "none.npz")
    with pytest.raises(OutputError, match="mkdir -p"):
        save(body, tmp_path / "none" / "body.npz")


def test_only_gaussian_processes_can_be_saved(body: BodyModel, tmp_path: Path) -> None:
    class Other:
        outputs = ("u",)

    with pytest.raises(ModelError, match="sense 'effector': a Other cannot be saved"):
        save(replace(body, senses={"effector": Other()}), tmp_path / "body.npz")
    assert not list(tmp_path.iterdir())


def test_older_touch_constants_are_read(body: BodyModel, tmp_path: Path) -> None:
    path = tmp_path / "old.npz"
    save(body, path)
    units = {"joints": "rad", "encoder": "rad^2", "process": "rad^2/s^3", "b1": "1/px^2", "b2": "1/s^2", "cells": "px"}
    _header(touch={"a1": 1.0, "b1": 0.003, "a2": 1.0, "b2": 200.0}, units=units)(path)
    assert load_body(path).touch == TouchConstants(1.0, 0.003)


def test_save_refuses_a_model_that_could_not_be_loaded(body: BodyModel, tmp_path: Path) -> None:
    noise = replace(body.noise, senses={name: (1e37,) * len(v) for name, v in body.noise.senses.items()})
    with pytest.raises(ModelError, match=r"noise\.senses.*possible: a list of finite numbers"):
        save(replace(body, noise=noise), tmp_path / "body.npz")
    assert not list(tmp_path.iterdir())
