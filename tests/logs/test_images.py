"""Every storage of an image gives the stored image; anything else is refused by name."""

import base64
import json
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bodylog.errors import FormatError, LogError
from bodylog.logs.decode.columns import definition_of
from bodylog.logs.decode.layout import Picker
from bodylog.logs.images import video_file
from bodylog.logs.images.codecs import check_size, stated_size
from bodylog.logs.images.messages import ENCODINGS, explain_refused_image, make_image_decoder
from bodylog.logs.limits import Input
from bodylog.types import LazyImage, Topic

from .writing import T0, cdr, compressed, define, descriptors, header, wire

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
RAW_TEXT = """builtin_interfaces/Time timestamp
string frame_id
uint32 width
uint32 height
string encoding
uint32 step
uint8[] data
"""


def topic(type_: str, definition: bytes | None = None, encoding: str = "cdr") -> Topic:
    dialect = {"cdr": "ros2msg", "json": "jsonschema", "protobuf": "protobuf"}[encoding]
    return Topic(1, "/cam", type_, encoding, define(type_) if definition is None else definition, dialect, 1)


def raw(encoding: str, rows: np.ndarray, width: int, step: int | None = None, big: bool = False) -> bytes:
    """An Image payload whose lines are the bytes `rows`, padded with 0xAB to `step`."""
    line = rows.reshape(len(rows), -1).view(np.uint8)
    padded = np.full((len(line), step or line.shape[1]), 0xAB, np.uint8)
    padded[:, : line.shape[1]] = line
    sizes = {"height": len(rows), "width": width, "step": padded.shape[1]}
    return cdr(IMAGE, header=header(T0), encoding=encoding, is_bigendian=int(big), data=padded.ravel(), **sizes)


def scene(seed: int, height: int = 23, width: int = 31, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), np.uint8)


def stored(encoding: str, bgr: np.ndarray) -> np.ndarray:
    """The pixels of a BGR scene as `encoding` stores them."""
    alpha = np.full((*bgr.shape[:2], 1), 77, np.uint8)
    base = encoding.rstrip("0123456789")
    rgb = bgr[:, :, ::-1]
    order = {"bgr": bgr, "rgb": rgb, "bgra": np.dstack([bgr, alpha]), "rgba": np.dstack([rgb, alpha])}
    return np.ascontiguousarray(order[base] if base in order else bgr[:, :, :1])


PACKED = ("bgr8", "rgb8", "bgra8", "rgba8", "mono8")


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", PACKED)
def test_decoder_reads_packed_encodings(encoding, padding):
    bgr = scene(1)
    pixels = stored(encoding, bgr)
    want = np.repeat(pixels, 3, axis=2) if encoding == "mono8" else bgr
    payload = raw(encoding, pixels, 31, pixels.shape[1] * pixels.shape[2] + padding)
    for k in (1, 2, 4, 8):
        np.testing.assert_array_equal(make_image_decoder(topic(IMAGE))(payload, k), want[::k, ::k])


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("encoding", ["bgr16", "rgb16", "bgra16", "rgba16", "mono16", "16UC1"])
def test_decoder_keeps_the_high_byte_of_16_bits(encoding, big):
    bgr = scene(2)
    high = stored(encoding.replace("16UC1", "mono16"), bgr)
    low = scene(3, channels=high.shape[2])
    wide = (high.astype(np.uint16) << 8 | low).astype(">u2" if big else "<u2")
    want = np.repeat(high, 3, axis=2) if high.shape[2] == 1 else bgr
    np.testing.assert_array_equal(make_image_decoder(topic(IMAGE))(raw(encoding, wide, 31, big=big), 1), want)
    np.testing.assert_array_equal(make_image_decoder(topic(IMAGE))(raw(encoding, wide, 31, 31 * 8 + 2, big), 4), want[::4, ::4])


@pytest.mark.parametrize("size", [8, 16])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_decoder_reads_bayer_patterns(pattern, size):
    colour = {"b": 20, "g": 120, "r": 230}
    cell = np.array([[colour[pattern[0]], colour[pattern[1]]], [colour[pattern[2]], colour[pattern[3]]]], np.uint8)
    mosaic = np.tile(cell, (6, 8))
    rows = mosaic if size == 8 else (mosaic.astype("<u2") << 8)
    image = make_image_decoder(topic(IMAGE))(raw(f"bayer_{pattern}{size}", rows, 16), 1)
    np.testing.assert_array_equal(image[2:-2, 2:-2], np.broadcast_to([20, 120, 230], (8, 12, 3)))


def halved(encoding: str, y: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Lines (3H/2, W): brightness (H,W), then colour (H/2, W/2, 2) as `encoding` stores it."""
    below = {"nv12": uv, "nv21": uv[:, :, ::-1], "i420": np.moveaxis(uv, 2, 0)}[encoding]
    return np.vstack([y, np.ascontiguousarray(below).reshape(-1, y.shape[1])])


@pytest.mark.parametrize("encoding", ["nv12", "nv21", "i420"])
def test_decoder_reads_yuv420_as_bt601(encoding):
    rng = np.random.default_rng(5)
    y, uv = rng.integers(60, 180, (10, 12)).astype(np.uint8), rng.integers(100, 156, (5, 6, 2)).astype(np.uint8)
    u, v = (np.repeat(np.repeat(uv[:, :, n].astype(float) - 128, 2, axis=1), 2, axis=0) for n in (0, 1))
    bright = 1.164 * (y.astype(float) - 16)
    want = np.clip(np.stack([bright + 2.018 * u, bright - 0.813 * v - 0.391 * u, bright + 1.596 * v], axis=2), 0, 255)
    lines = halved(encoding, y, uv)

    def payload(step: int, height: int = 10, declared: int | None = None) -> bytes:
        padded = np.full((len(lines), step), 0xAB, np.uint8)
        padded[:, :12] = lines
        sizes = {"height": height, "width": 12, "step": step if declared is None else declared}
        return cdr(IMAGE, header=header(T0), encoding=encoding, is_bigendian=0, data=padded.ravel(), **sizes)

    decode = make_image_decoder(topic(IMAGE))
    image = decode(payload(12), 1)
    assert np.abs(image - want).max() <= 2
    np.testing.assert_array_equal(decode(payload(12), 2), image[::2, ::2])
    for declared in (0, 18, 24):
        np.testing.assert_array_equal(decode(payload(12, declared=declared), 1), image)
    if encoding != "i420":
        np.testing.assert_array_equal(decode(payload(16), 1), image)
    for wrong in (payload(12, height=9), payload(12, height=12), *([payload(16)] if encoding == "i420" else [])):
        with pytest.raises(FormatError, match=f"12 x .* {encoding} with step"):
            decode(wrong, 1)


@pytest.mark.parametrize(
    ("encoding", "luma"), [("yuv422", 1), ("uyvy", 1), ("yuv422_yuy2", 0), ("yuyv", 0), ("yuy2", 0)]
)
def test_decoder_reads_yuv422_as_bt601(encoding, luma):
    rng = np.random.default_rng(4)
    y, uv = rng.integers(60, 180, (10, 12)).astype(np.uint8), rng.integers(100, 156, (10, 6, 2)).astype(np.uint8)
    packed = np.empty((10, 12, 2), np.uint8)
    packed[:, :, luma] = y
    packed[:, :, 1 - luma] = uv.reshape(10, 12)
    u, v = (np.repeat(uv[:, :, n].astype(float) - 128, 2, axis=1) for n in (0, 1))
    bright = 1.164 * (y.astype(float) - 16)
    want = np.stack([bright + 2.018 * u, bright - 0.813 * v - 0.391 * u, bright + 1.596 * v], axis=2)
    image = make_image_decoder(topic(IMAGE))(raw(encoding, packed, 12), 1)
    assert np.abs(image - np.clip(want, 0, 255)).max() <= 2
    np.testing.assert_array_equal(make_image_decoder(topic(IMAGE))(raw(encoding, packed, 12), 2), image[::2, ::2])


def test_encodings_are_all_tested():
    yuv = {"yuv422", "uyvy", "yuv422_yuy2", "yuyv", "yuy2", "nv12", "nv21", "i420"}
    wide = {"bgr16", "rgb16", "bgra16", "rgba16", "mono16", "16UC1"}
    bayer = {f"bayer_{p}{s}" for p in ("rggb", "bggr", "gbrg", "grbg") for s in (8, 16)}
    opencv = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8"}
    assert set(ENCODINGS) == {*PACKED, *yuv, *wide, *bayer, *opencv}
    for alias, name in opencv.items():
        assert ENCODINGS[alias] == ENCODINGS[name]


@pytest.mark.parametrize(
    ("suffix", "form"), [(".png", "png"), (".png", "bgr8; png compressed bgr8"), (".webp", "webp")]
)
def test_decoder_returns_lossless_images_exactly(suffix, form):
    bgr = scene(5)
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    data = cv2.imencode(suffix, bgr, options)[1].ravel()
    payload = cdr(COMPRESSED, header=header(T0), format=form, data=data)
    np.testing.assert_array_equal(make_image_decoder(topic(COMPRESSED))(payload, 1), bgr)
    for k in (2, 4, 8):
        height, width = bgr.shape[0] // k, bgr.shape[1] // k
        means = bgr[: height * k, : width * k].reshape(height, k, width, k, 3).mean(axis=(1, 3))
        np.testing.assert_allclose(make_image_decoder(topic(COMPRESSED))(payload, k), means, atol=0.51)


@pytest.mark.parametrize("form", ["jpeg", "jpg", "bgr8; jpeg compressed bgr8", ""])
@pytest.mark.parametrize("shape", [(48, 64), (47, 61)])
def test_decoder_shrinks_jpeg_while_decoding(form, shape):
    row, column = np.mgrid[: shape[0], : shape[1]]
    bgr = np.stack([row * 4, column * 3, 200 - row - column], axis=2).astype(np.uint8)
    payload = compressed(T0, bgr, ".jpg", form)
    for k in (1, 2, 4, 8):
        image = make_image_decoder(topic(COMPRESSED))(payload, k)
        assert image.shape == (-(-shape[0] // k), -(-shape[1] // k), 3)
        blocks = bgr[: shape[0] // k * k, : shape[1] // k * k].reshape(shape[0] // k, k, shape[1] // k, k, 3)
        assert np.abs(image[: shape[0] // k, : shape[1] // k] - blocks.mean(axis=(1, 3))).mean() < 4


def _jpegs() -> Iterator[tuple[str, bytes]]:
    smooth = cv2.resize(scene(3, 12, 16), (95, 71), interpolation=cv2.INTER_CUBIC)
    for name, value in {"444": 0x111111, "422": 0x211111, "420": 0x221111, "440": 0x121111, "411": 0x411111}.items():
        yield name, cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, value])[1].tobytes()
    yield "grey", cv2.imencode(".jpg", smooth[:, :, 0])[1].tobytes()
    yield "progressive", cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    yield "restarts", cv2.imencode(".jpg", smooth, [cv2.IMWRITE_JPEG_RST_INTERVAL, 4])[1].tobytes()
    whole = cv2.imencode(".jpg", smooth)[1].tobytes()
    yield "tail", whole + bytes(20)
    yield "no end", whole[:-2]
    yield "bytes lost", whole[:900] + whole[940:]
    yield "bytes changed", whole[:900] + b"\x55\xaa" + whole[902:]
    yield "marker between", whole[:900] + b"\xff\xd0" + whole[900:]


@pytest.mark.parametrize(("kind", "data"), list(_jpegs()), ids=lambda value: value if isinstance(value, str) else "")
def test_decoder_equals_opencv_for_any_jpeg(kind, data):
    payload = cdr(COMPRESSED, header=header(T0), format="jpeg", data=np.frombuffer(data, np.uint8))
    flags = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
    for k, flag in flags.items():
        expected = cv2.imdecode(np.frombuffer(data, np.uint8), flag)
        if expected is None:
            with pytest.raises(FormatError, match="cannot be decoded"):
                make_image_decoder(topic(COMPRESSED))(payload, k)
        else:
            np.testing.assert_array_equal(make_image_decoder(topic(COMPRESSED))(payload, k), expected)


def test_decoder_ignores_the_jpeg_orientation_tag():
    red = np.zeros((16, 32, 3), np.uint8)
    red[:, :, 2] = 255
    plain = cv2.imencode(".jpg", red)[1].tobytes()
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    turned = plain[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + plain[2:]
    payload = cdr(COMPRESSED, header=header(T0), format="jpeg", data=np.frombuffer(turned, np.uint8))
    image = make_image_decoder(topic(COMPRESSED))(payload, 1)
    assert image.shape == (16, 32, 3)
    assert np.abs(image.astype(int) - [0, 0, 255]).max() < 5


def test_decoder_reads_foxglove_json_and_ros2msg():
    bgr = scene(6)
    png = cv2.imencode(".png", bgr)[1].tobytes()
    held = json.dumps({"timestamp": {"sec": 1, "nsec": 2}, "format": "png", "data": base64.b64encode(png).decode()})
    read = make_image_decoder(topic("foxglove.CompressedImage", b"{}", "json"))
    np.testing.assert_array_equal(read(held.encode(), 1), bgr)
    lines = base64.b64encode(bgr[:, :, ::-1].tobytes()).decode()
    held = json.dumps({"width": 31, "height": 23, "encoding": "rgb8", "step": 93, "data": lines})
    np.testing.assert_array_equal(make_image_decoder(topic("foxglove.RawImage", b"{}", "json"))(held.encode(), 2), bgr[::2, ::2])
    body = struct.pack("<iII4sIII8s", 5, 6, 4, b"cam\0", 31, 23, 5, b"rgb8")
    payload = b"\0\1\0\0" + body + struct.pack("<II", 93, bgr.size) + bgr[:, :, ::-1].tobytes()
    read = make_image_decoder(topic("foxglove_msgs/msg/RawImage", RAW_TEXT.encode()))
    np.testing.assert_array_equal(read(payload, 1), bgr)


def test_decoder_reads_foxglove_protobuf():
    bgr = scene(7)
    stamp = ("timestamp", 1, 11, ".google.protobuf.Timestamp")
    times = descriptors("google.protobuf", {"Timestamp": [("seconds", 1, 3, ""), ("nanos", 2, 5, "")]})
    plain = (("width", 2, 7), ("height", 3, 7), ("encoding", 4, 9), ("step", 5, 7), ("data", 6, 12))
    fields = [stamp, *((*field, "") for field in plain)]
    schema = times + descriptors("foxglove", {"RawImage": fields})
    sizes = b"".join(wire(n, (struct.pack("<I", value),)) for n, value in ((2, 31), (3, 23), (5, 93)))
    payload = wire(1, wire(1, 5) + wire(2, 6)) + sizes + wire(4, b"bgr8") + wire(6, bgr.tobytes())
    read = make_image_decoder(topic("foxglove.RawImage", schema, "protobuf"))
    np.testing.assert_array_equal(read(payload, 4), bgr[::4, ::4])
    with pytest.raises(FormatError, match=r"^/cam: "):
        read(payload[:-1], 1)


@pytest.mark.parametrize(
    "odd",
    [
        {"height": "x"}, {"height": -2, "width": -3}, {"data": [1, 2]}, {"data": "*"}, {"data": None},
        {"step": {"a": 1}}, {"encoding": 7},
    ],
)  # fmt: skip
def test_decoder_refuses_other_json_values(odd):
    held = {"width": 1, "height": 1, "encoding": "mono8", "step": 1, "data": "AA=="}
    read = make_image_decoder(topic("foxglove.RawImage", b"{}", "json"))
    assert read(json.dumps(held).encode(), 1).shape == (1, 1, 3)
    with pytest.raises(FormatError, match=r"^/cam: "):
        read(json.dumps({**held, **odd}).encode(), 1)


@pytest.mark.parametrize(
    ("type_", "text", "says"),
    [
        (COMPRESSED, "16UC1; compressedDepth png", "compressedDepth"),
        (IMAGE, "32FC1", "encoding '32FC1'; possible: bgr8, "),
        (COMPRESSED, "h264", "format 'h264' is a video's packets"),
        (IMAGE, "bgr8", None),
        (COMPRESSED, "jpeg", None),
    ],
)
def test_refusal_gives_a_reason(type_, text, says):
    reason = explain_refused_image(topic(type_), text)
    assert (reason is None) == (says is None)
    assert says is None or says in str(reason)


@pytest.mark.parametrize(
    ("payload", "says"),
    [
        (lambda: raw("32FC1", scene(8), 31), "encoding '32FC1'; possible:"),
        (lambda: raw("bgr8", scene(8), 32), r"for 32 x 23 bgr8 with step 93"),
        (lambda: raw("bgr8", scene(8)[:, :0], 0, 4), "0 x 23 pixels"),
        (lambda: _raw_sizes(1 << 20, 1 << 20, 3 << 20), r"1048576 x 1048576 pixels, .* max_image_mpx = 1099512"),
        (lambda: _raw_sizes(4000, 4000, 12000), "4000 x 12000 needed"),
    ],
)
def test_decoder_refuses_inconsistent_raw_images(payload, says):
    with pytest.raises(FormatError, match=says):
        make_image_decoder(topic(IMAGE))(payload(), 1)


def _raw_sizes(height: int, width: int, step: int) -> bytes:
    sizes = {"height": height, "width": width, "step": step}
    return cdr(IMAGE, header=header(T0), encoding="bgr8", is_bigendian=0, data=np.zeros(100, np.uint8), **sizes)


PNG = cv2.imencode(".png", scene(9))[1].tobytes()
JPEG = cv2.imencode(".jpg", scene(9))[1].tobytes()


@pytest.mark.parametrize(
    ("form", "data", "says"),
    [
        ("16UC1; compressedDepth", PNG, "is compressedDepth"),
        ("tiff", b"II*\0" + bytes(50), "can read jpeg, png and webp"),
        ("jpeg", b"", "beginning with nothing"),
        ("jpeg", JPEG[:9], "header is cut off"),
        ("png", PNG[:16] + struct.pack(">II", 1 << 17, 1 << 17) + PNG[24:], "131072 x 131072 pixels"),
        ("png", PNG[:40], "of 40 bytes is cut off"),
        ("png", PNG[:-13], "is cut off"),
        ("png", PNG[:60] + bytes([PNG[60] ^ 1]) + PNG[61:], "chunk IDAT fails its checksum"),
    ],
)
def test_decoder_refuses_invalid_compressed_images(form, data, says):
    payload = cdr(COMPRESSED, header=header(T0), format=form, data=np.frombuffer(data, np.uint8))
    with pytest.raises(FormatError, match=says):
        make_image_decoder(topic(COMPRESSED))(payload, 1)


def test_decoder_suppresses_library_output(capfd):
    """Cameras that write extra bytes before the end of each JPEG would flood the screen."""
    jpeg = cv2.imencode(".jpg", scene(9))[1].tobytes()
    broken = {"jpeg": [jpeg[:-2] + bytes(9) + jpeg[-2:], *(_changed(jpeg, at) for at in range(640, len(jpeg) - 2, 50))]}
    broken["png"] = [PNG[:300], *(_changed(PNG, at) for at in range(8, len(PNG), 50))]
    for form, some in broken.items():
        for data in some:
            with suppress(FormatError):
                payload = cdr(COMPRESSED, header=header(T0), format=form, data=np.frombuffer(data, np.uint8))
                make_image_decoder(topic(COMPRESSED))(payload, 1)
    assert capfd.readouterr().err == ""


def _changed(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 2**31),
    flips=st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), min_size=1, max_size=4),
)
def test_decoder_survives_damaged_payloads(seed, flips):
    whole = raw("bgr8", scene(seed), 31) if seed % 2 else compressed(T0, scene(seed), ".jpg", "jpeg")
    broken = bytearray(whole)
    for where, bits in flips:
        broken[where % len(broken)] ^= bits
    try:
        image = make_image_decoder(topic(IMAGE if seed % 2 else COMPRESSED))(bytes(broken), 1)
    except FormatError:
        return
    assert image.ndim == 3 and image.shape[2] == 3 and image.dtype == np.uint8


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["cam", "camera", ""]),
            st.sampled_from(["jpeg", "png"]),
            st.binary(max_size=9),
            st.integers(0, 3),
            st.integers(0, 60),
        ),
        min_size=2,
        max_size=6,
    )
)
def test_picker_is_independent_of_earlier_messages(messages):
    definition = definition_of(topic(COMPRESSED))
    wanted = (("header", "frame_id"), ("format",), ("data",))
    shared = Picker(definition, wanted, False)
    for frame, form, data, more, cut in messages:
        declared = header(T0, frame)
        whole = cdr(COMPRESSED, header=declared, format=form, data=np.frombuffer(data, np.uint8)) + bytes(more)
        payload = whole[: max(4, len(whole) - max(0, cut - 40))]
        results = []
        for picker in (shared, Picker(definition, wanted, False)):
            try:
                results.append([bytes(one) if isinstance(one, memoryview) else one for one in picker(payload)])
            except FormatError as error:
                results.append([str(error)])
        assert results[0] == results[1]
        if cut <= 40:
            assert results[0] == [frame, form, data]


def test_frame_image_is_writable():
    payload = raw("bgr8", scene(11), 31)
    image = LazyImage(0.0, 0, partial(make_image_decoder(topic(IMAGE)), payload)).image
    image[:] = 0
    np.testing.assert_array_equal(make_image_decoder(topic(IMAGE))(payload, 1), scene(11))


def test_decoder_is_thread_safe():
    payloads = [compressed(T0, scene(seed, 60, 80), ".jpg", "jpeg") for seed in range(24)]
    read = make_image_decoder(topic(COMPRESSED))
    alone = [read(payload, 2) for payload in payloads]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda payload: read(payload, 2), payloads))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("form", ["bmp", "tiff", "ppm", "pgm", "pbm"])
def test_sizes_that_files_state_are_those_of_the_images(form):
    for height, width in ((1, 1), (7, 300), (480, 640)):
        image = np.zeros((height, width) if form in ("pgm", "pbm") else (height, width, 3), np.uint8)
        data = cv2.imencode(f".{form}", image)[1].tobytes()
        assert stated_size(memoryview(data)) == (height, width)


def test_sizes_of_other_images_are_refused():
    damaged = (b"", b"BM", b"II*\0" + bytes(50), b"P6 9", b"MM\0*\xff\xff\xff\xff")
    for data in (*damaged, b"P7\nWIDTH 9", b"GIF89a" + bytes(50)):
        with pytest.raises(FormatError):
            check_size(*stated_size(memoryview(data)), 32.0)


def test_a_tiff_states_the_size_of_its_tiles_too():
    """A directory of one image of 16 x 16 px in tiles of 65535 x 65535."""
    tags = ((256, 16), (257, 16), (322, 65535), (323, 65535))
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    data = b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + bytes(4)
    assert stated_size(memoryview(data)) == (65535, 65535)


def _film(path, count, width, height):
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (width, height))
    for number in range(count):
        writer.write(np.full((height, width, 3), 10 * number, np.uint8))
    writer.release()
    return path


def test_images_of_a_side_video_that_grew_or_changed_its_size_are_left_out(tmp_path):
    path = _film(tmp_path / "film.avi", 4, 64, 48)
    side = video_file.find_video_file("film.avi", tmp_path / "log.mcap", None, Input(max_frames=5))
    assert [round(frame.t, 6) for frame in video_file.make_video_decoder(side, 1.0, 0)()] == [1.0, 1.1, 1.2, 1.3]
    _film(path, 9, 64, 48)
    assert len(list(video_file.make_video_decoder(side, 0.0, 0)())) == 4
    _film(path, 4, 640, 480)
    changed = list(video_file.make_video_decoder(side, 0.0, 0)())
    with pytest.raises(FormatError, match=r"film.avi: image 0 is damaged or of another size"):
        changed[0].decode(1)
    with pytest.raises(LogError, match=r"film.avi: more than 3 images; .*\[input\] max_frames = 30"):
        video_file.find_video_file("film.avi", tmp_path / "log.mcap", None, Input(max_frames=3))
    with pytest.raises(LogError, match=r"film.avi: images of 640 x 480; set \[input\] max_image_mpx"):
        video_file.find_video_file("film.avi", tmp_path / "log.mcap", None, Input(max_image_mpx=0.01))
