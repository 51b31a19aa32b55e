"""Pictures from files: every kind comes out as 8-bit RGB, and nothing damaged gets through."""

import os
import struct
import sys
import zlib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from twohands.errors import InputError, MissingExtraError
from twohands.formats.pictures import (
    MAX_PIXELS,
    FolderContent,
    decode_image,
    decode_pixels,
    list_images,
    look_through,
    read_image,
    read_pixels,
)

RGB = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
SMOOTH = np.ascontiguousarray(
    np.stack(np.meshgrid(np.linspace(0, 255, 64), np.linspace(0, 255, 48)), -1)[..., [0, 1, 0]].astype(np.uint8)
)


def encoded(suffix: str, pixels: np.ndarray = RGB, *options: int) -> bytes:
    """An image file's bytes, from RGB, RGBA or grey."""
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR)
    return cv2.imencode(suffix, pixels, options)[1].tobytes()


PROGRESSIVE = (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
RESTART = (cv2.IMWRITE_JPEG_RST_INTERVAL, 2)
FILES = {
    "png": encoded(".png"),
    "bmp": encoded(".bmp"),
    "tiff": encoded(".tiff"),
    "packed tiff": encoded(".tiff", RGB, cv2.IMWRITE_TIFF_COMPRESSION, 5),
    "webp": encoded(".webp", SMOOTH),
    "jpeg": encoded(".jpg", SMOOTH),
    "progressive jpeg": encoded(".jpg", SMOOTH, *PROGRESSIVE),
    "jpeg with restart markers": encoded(".jpg", SMOOTH, *RESTART),
}
if cv2.haveImageWriter(".avif"):
    FILES["avif"] = encoded(".avif", SMOOTH)


@pytest.mark.parametrize("kind", ["png", "bmp", "tiff", "packed tiff"])
def test_lossless_files_come_out_as_they_went_in(kind):
    np.testing.assert_array_equal(decode_image(FILES[kind]), RGB)


@pytest.mark.parametrize("kind", [kind for kind in FILES if "jpeg" in kind or kind in ("webp", "avif")])
def test_lossy_files_keep_channel_order_and_look(kind):
    assert np.abs(decode_image(FILES[kind]).astype(int) - SMOOTH).mean() < 4


def test_grey_16_bit_and_transparent_pictures_are_converted():
    grey = RGB[..., 0]
    np.testing.assert_array_equal(decode_image(encoded(".png", grey)), np.stack([grey] * 3, -1))
    deep = np.ascontiguousarray(RGB.astype(np.uint16) * 257)
    np.testing.assert_array_equal(decode_image(cv2.imencode(".png", deep[..., ::-1])[1].tobytes()), RGB)
    deep_grey = cv2.imencode(".png", deep[..., 0])[1].tobytes()
    np.testing.assert_array_equal(decode_image(deep_grey), np.stack([grey] * 3, -1))
    alpha = np.full((48, 64, 1), 255, np.uint8)
    alpha[:, :32], alpha[:, 32:40] = 0, 51
    on_black = decode_image(encoded(".png", np.concatenate([RGB, alpha], axis=2)))
    assert (on_black[:, :32] == 0).all()
    np.testing.assert_array_equal(on_black[:, 32:40], np.rint(RGB[:, 32:40] * 0.2))
    np.testing.assert_array_equal(on_black[:, 40:], RGB[:, 40:])


@pytest.mark.parametrize(("value", "expected"), [(0, 0), (128, 0), (129, 1), (65535, 255), (32896, 128)])
def test_16_bits_are_divided_by_257_and_rounded(value, expected):
    deep = np.full((40, 40), value, np.uint16)
    assert (decode_image(cv2.imencode(".png", deep)[1].tobytes()) == expected).all()


@pytest.mark.parametrize("kind", FILES)
def test_every_truncation_is_refused(kind):
    """Wherever the file is cut: in the signature, a header, the pixels, or the last byte of the end marker."""
    data = FILES[kind]
    cuts = {*range(1, min(64, len(data))), *range(64, len(data), 37), *range(len(data) - 16, len(data))}
    for cut in sorted(cuts):
        with pytest.raises(InputError, match=r"cut off|damaged|not an image"):
            decode_image(data[:cut])


def test_a_cut_jpeg_with_a_thumbnail_is_not_saved_by_the_thumbnails_end_marker():
    thumbnail = encoded(".jpg", SMOOTH[:40, :40])
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 8) + b"Exif\x00\x00" + thumbnail
    whole = FILES["jpeg"][:2] + segment + FILES["jpeg"][2:]
    assert decode_image(whole).shape == (48, 64, 3)
    with pytest.raises(InputError, match="cut off"):
        decode_image(whole[: len(segment) + 300])


@pytest.mark.parametrize("kind", FILES)
def test_bytes_after_the_end_do_no_harm(kind):
    """Phones append videos to their photographs."""
    assert decode_image(FILES[kind] + b"\x00appended\xff\xd8\xff" * 9).shape == (48, 64, 3)


def test_a_flipped_bit_in_a_png_is_refused():
    data = bytearray(FILES["png"])
    for place in range(30, len(data) - 16, len(data) // 7):
        data[place] ^= 1
        with pytest.raises(InputError, match="cut off or damaged"):
            decode_image(bytes(data))
        data[place] ^= 1
    assert decode_image(bytes(data)).shape == (48, 64, 3)


def test_a_png_that_promises_rows_it_does_not_hold_is_refused():
    """Header changed to twice the height, checksum mended: complete as a file, too short as a picture."""
    data = FILES["png"]
    header = bytearray(data[16:29])
    header[4:8] = struct.pack(">I", 96)
    checksum = struct.pack(">I", zlib.crc32(b"IHDR" + bytes(header)))
    with pytest.raises(InputError):
        decode_image(data[:16] + bytes(header) + checksum + data[33:])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "empty"),
        (b"hello, this is text" * 10, "not an image"),
        (b"GIF89a" + bytes(100), "a GIF, no picture that can be read; make it a PNG or JPEG"),
        (b"\0\0\0\x0cJXL \r\n\x87\n" + bytes(100), "a JPEG XL"),
        (b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(100), "a JPEG 2000"),
        (b"\0\0\0\x18ftypcrx " + bytes(100), "a camera's raw picture"),
        (b"\0\0\0\x18ftypqt  " + bytes(100), "a video, .* endings"),
        (b"P6 64 48 255\n" + bytes(100), "a PNM"),
        (b"\x00" * 500, "not an image"),
        (encoded(".png", RGB[:1, :1]), "too small: 1x1"),
        (encoded(".png", RGB[:31, :64]), "too small: 64x31"),
    ],
)
def test_what_is_no_usable_picture_is_named(data, message):
    with pytest.raises(InputError, match=message):
        decode_image(data)


def test_a_chunk_that_announces_gigabytes_is_not_decoded(monkeypatch):
    """libpng asks for them before it looks: 4.3 GB for a file of 500 bytes, in a data set."""
    data = bytearray(FILES["png"])
    data[33:37] = b"\xff" * 4  # the length of the first IDAT
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    assert decode_pixels(bytes(data), cv2.IMREAD_UNCHANGED) is None


def test_32_pixels_are_enough():
    assert decode_image(encoded(".png", RGB[:32, :32])).shape == (32, 32, 3)


def test_a_cameras_orientation_is_applied():
    """EXIF orientation 6: the picture is to be turned a quarter clockwise."""
    tiff = b"II*\x00\x08\x00\x00\x00" + struct.pack("<HHHIHHI", 1, 0x0112, 3, 1, 6, 0, 0)
    segment = b"\xff\xe1" + struct.pack(">H", len(tiff) + 8) + b"Exif\x00\x00" + tiff
    turned = decode_image(FILES["jpeg"][:2] + segment + FILES["jpeg"][2:])
    assert turned.shape == (64, 48, 3)
    assert np.abs(turned.astype(int) - np.rot90(SMOOTH, -1)).mean() < 4


def exif(orientation: int) -> bytes:
    """The smallest block that notes how a camera was held."""
    return b"II*\0" + struct.pack("<IHHHIHHI", 8, 1, 0x112, 3, 1, orientation, 0, 0)


def chunk(kind: bytes, content: bytes) -> bytes:
    """A chunk of a PNG file."""
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))


@pytest.mark.parametrize("depth", [8, 16])
def test_a_cameras_orientation_is_applied_in_png(depth):
    """6: the camera was turned to the right."""
    pixels = RGB if depth == 8 else RGB.astype(np.uint16) * 257
    data = encoded(".png", np.ascontiguousarray(pixels))
    turned = decode_image(data[:33] + chunk(b"eXIf", exif(6)) + data[33:])
    np.testing.assert_array_equal(turned, np.rot90(RGB, -1))


def test_a_cameras_orientation_is_applied_in_webp():
    plain = encoded(".webp", RGB, cv2.IMWRITE_WEBP_QUALITY, 101)  # lossless
    note = exif(6)
    header = b"VP8X" + struct.pack("<II", 10, 8) + struct.pack("<I", 63)[:3] + struct.pack("<I", 47)[:3]
    chunks = header + plain[12:] + b"EXIF" + struct.pack("<I", len(note)) + note
    data = b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WEBP" + chunks
    np.testing.assert_array_equal(decode_image(data), np.rot90(RGB, -1))


def test_a_32_bit_bmp_whose_fourth_byte_is_unused_is_no_transparent_picture():
    pixels = np.dstack([RGB[::-1, :, ::-1], np.zeros(RGB.shape[:2], np.uint8)])  # from the bottom row up, BGR0
    masks = struct.pack("<III", 0xFF0000, 0xFF00, 0xFF)
    header = struct.pack("<IiiHHIIiiII", 40, 64, 48, 1, 32, 3, pixels.nbytes, 2835, 2835, 0, 0)
    data = b"BM" + struct.pack("<IHHI", 66 + pixels.nbytes, 0, 0, 66) + header + masks + pixels.tobytes()
    np.testing.assert_array_equal(decode_image(data), RGB)


def test_the_file_is_named_in_the_message(tmp_path):
    with pytest.raises(InputError, match=r"missing\.png: no such file"):
        read_image(tmp_path / "missing.png")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path)
    (tmp_path / "text.jpg").write_text("not a picture at all")
    with pytest.raises(InputError, match=r"text\.jpg: not an image"):
        read_image(tmp_path / "text.jpg")


def test_content_decides_not_the_name(tmp_path):
    (tmp_path / "really_png.jpg").write_bytes(FILES["png"])
    np.testing.assert_array_equal(read_image(str(tmp_path / "really_png.jpg")), RGB)


def test_a_folders_images_come_in_natural_order(tmp_path):
    for name in ("b10.png", "b9.PNG", "a.jpeg", ".hidden.png"):
        (tmp_path / name).write_bytes(FILES["png"])
    for name in ("notes.txt", "camera.json"):
        (tmp_path / name).write_text("no picture")
    (tmp_path / "folder.png").mkdir()
    assert [path.name for path in list_images(tmp_path)] == ["a.jpeg", "b9.PNG", "b10.png"]


def test_a_digit_that_is_no_decimal_is_a_letter(tmp_path):
    for name in ("1²3.png", "1.png"):
        (tmp_path / name).touch()
    assert len(list_images(tmp_path)) == 2


def test_a_folder_without_images_is_refused(tmp_path):
    with pytest.raises(InputError, match="no image in this folder"):
        list_images(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        list_images(tmp_path / "missing")


def test_a_folder_that_may_be_listed_but_not_entered_is_refused(tmp_path, monkeypatch):
    def forbidden(path):
        raise PermissionError(13, "Permission denied")

    (tmp_path / "a.png").touch()
    monkeypatch.setattr(Path, "is_dir", forbidden)
    with pytest.raises(InputError, match="cannot be read: Permission denied"):
        list_images(tmp_path)


FIELD = Path(__file__).parents[3] / "shared" / "field"


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["TIFF", "AVIF", "PNG", "WEBP", "JPEG"])
def test_every_kind_comes_out_upright(kind, orientation, tmp_path):
    """All eight ways that a camera can be held or mirrored, by the kind's own way of noting it."""
    image = pytest.importorskip("PIL.Image")
    features = pytest.importorskip("PIL.features")
    if kind == "AVIF" and not (features.check("avif") and cv2.haveImageWriter(".avif")):
        pytest.skip("AVIF cannot be written or read here")
    upright = np.zeros((96, 128, 3), np.uint8)
    upright[:48, :64], upright[:, 112:] = 255, (255, 0, 0)
    undo = {1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1]}
    undo |= {
        5: upright.swapaxes(0, 1),
        6: np.rot90(upright, 1),
        7: np.rot90(upright.swapaxes(0, 1), 2),
        8: np.rot90(upright, -1),
    }
    stored = image.fromarray(np.ascontiguousarray(undo[orientation]))
    exif = image.Exif()
    exif[0x112] = orientation
    options = {"tiffinfo": {274: orientation}} if kind == "TIFF" else {"exif": exif}
    stored.save(tmp_path / "a", kind, **options)
    found = read_image(tmp_path / "a")
    assert found.shape == upright.shape
    assert np.abs(found.astype(int) - upright).mean() < 4


@pytest.mark.parametrize("suffix", [".jfif", ".JPE", ".tif", ".tiff", ".avif", ".dib", ".heic"])
def test_every_ending_of_a_picture_is_found(suffix, tmp_path):
    (tmp_path / f"a{suffix}").touch()
    assert [path.suffix for path in list_images(tmp_path)] == [suffix]


def test_pictures_are_found_by_their_content_and_the_rest_is_listed(tmp_path):
    (tmp_path / "photo").write_bytes(FILES["jpeg"])
    (tmp_path / "photo.download").write_bytes(FILES["png"])
    for name in ("notes.txt", "raw.dng", "film.mov", ".hidden"):
        (tmp_path / name).write_bytes(b"something else")
    for name in ("DCIM10", "DCIM9", ".thumbnails"):
        (tmp_path / name).mkdir()
    content = look_through(tmp_path)
    assert [path.name for path in content.folders] == ["DCIM9", "DCIM10"], "named, though not looked into"
    assert [path.name for path in content.pictures] == ["photo", "photo.download"]
    assert [path.name for path in content.others] == ["film.mov", "notes.txt", "raw.dng"]
    assert content.left_out() == [
        "3 left out, no pictures that can be read: film.mov, notes.txt, raw.dng",
        "2 left out, folders are not looked into: DCIM9, DCIM10",
    ]
    many = FolderContent([], [Path(str(number)) for number in range(6)], [])
    assert many.left_out() == ["6 left out, no pictures that can be read: 0, 1, 2, 3, 4, ..."]


def test_links_to_nowhere_and_pipes_are_listed(tmp_path):
    """Not left out without a word, and not waited for."""
    (tmp_path / "photo.jpg").write_bytes(FILES["jpeg"])
    (tmp_path / "link.jpg").symlink_to("photo.jpg")
    (tmp_path / "broken.jpg").symlink_to("gone.jpg")
    (tmp_path / "loop.jpg").symlink_to("loop.jpg")
    (tmp_path / "folder.jpg").mkdir()
    os.mkfifo(tmp_path / "pipe.jpg")
    content = look_through(tmp_path)
    assert [path.name for path in content.pictures] == ["link.jpg", "photo.jpg"]
    assert [path.name for path in content.others] == ["broken.jpg", "loop.jpg", "pipe.jpg"]


def tiff(*tags: tuple[int, int]) -> bytes:
    """A grey TIFF of 64x48, and other tags; those of one number each, 16 bits."""
    known = {256: 64, 257: 48, 258: 8, 259: 1, 262: 1, 273: 512, 277: 1, 278: 48, 279: 64 * 48} | dict(tags)
    entries = b"".join(struct.pack("<HHIHxx", tag, 3, 1, value) for tag, value in sorted(known.items()))
    head = struct.pack("<2sHIH", b"II", 42, 8, len(known)) + entries + bytes(4)
    return head.ljust(512, b"\0") + RGB[..., 0].tobytes()


@pytest.mark.parametrize("tag", [(254, 1), (262, 32803), (262, 34892)])
def test_a_preview_in_a_raw_file_is_not_taken_for_the_picture(tag, tmp_path):
    """DNG, NEF and ARW are TIFFs whose first picture is a thumbnail: it was tracked, without a word."""
    np.testing.assert_array_equal(decode_image(tiff())[..., 0], RGB[..., 0])
    (tmp_path / "IMG_1.dng").write_bytes(tiff(tag))
    with pytest.raises(InputError, match=r"IMG_1\.dng: a camera's raw picture"):
        read_image(tmp_path / "IMG_1.dng")
    assert read_pixels(tmp_path / "IMG_1.dng", cv2.IMREAD_COLOR) is None


def test_the_raw_file_of_a_canon_is_none_that_is_cut_off():
    with pytest.raises(InputError, match="a camera's raw picture"):
        decode_image(b"II*\0\x10\0\0\0CR\x02\0" + bytes(200))


@pytest.mark.skipif(not cv2.haveImageWriter(".avif"), reason="this OpenCV cannot write AVIF")
@pytest.mark.parametrize("depth", [8, 10, 12])
def test_deep_avif_pictures_keep_their_brightness(depth):
    grey = np.full((64, 64, 3), (1 << depth) // 2, np.uint8 if depth == 8 else np.uint16)
    data = cv2.imencode(".avif", grey, [cv2.IMWRITE_AVIF_DEPTH, depth])[1].tobytes()
    assert abs(decode_image(data).mean() - 128) < 2


def headed(width: int, height: int) -> bytes:
    """A PNG that says it is as large, all checksums right, and holds next to nothing."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("width", "height"), [(40000, 30000), (2**31 - 1, 2**31 - 1), (MAX_PIXELS // 1000 + 1, 1000)])
def test_a_picture_of_too_many_pixels_is_refused_by_its_header(width, height, tmp_path):
    """OpenCV raises for more than 2^30 pixels, and takes the memory for fewer."""
    (tmp_path / "panorama.png").write_bytes(headed(width, height))
    with pytest.raises(InputError, match=rf"too large: {width}x{height}"):
        read_image(tmp_path / "panorama.png")
    assert read_pixels(tmp_path / "panorama.png", cv2.IMREAD_COLOR) is None


def test_a_heic_picture_names_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pi_heif", None)
    (tmp_path / "a.heic").write_bytes(heic(64, 48))
    with pytest.raises(MissingExtraError, match=r"a\.heic: a HEIC picture needs the extra 'heic'"):
        read_image(tmp_path / "a.heic")


def heic(width: int, height: int) -> bytes:
    """The descriptions of a HEIC file, and nothing to decode."""
    size = struct.pack(">I4sIII", 20, b"ispe", 0, width, height)
    ipco = struct.pack(">I4s", 8 + len(size), b"ipco") + size
    iprp = struct.pack(">I4s", 8 + len(ipco), b"iprp") + ipco
    meta = struct.pack(">I4sI", 12 + len(iprp), b"meta", 0) + iprp
    return struct.pack(">I4s4sI4s", 20, b"ftyp", b"heic", 0, b"mif1") + meta


@pytest.mark.parametrize("missing", [False, True])
def test_a_heic_picture_comes_out_upright(missing, monkeypatch):
    """Of 64x48 pixels, stored turned and mirrored (irot, imir), white above left and red at the right; or the extra is
    named."""
    data = (Path(__file__).parent / "files" / "turned.heic").read_bytes()
    if missing:
        monkeypatch.setitem(sys.modules, "pi_heif", None)
        with pytest.raises(MissingExtraError, match="extra 'heic'"):
            decode_image(data)
        return
    pytest.importorskip("pi_heif")
    upright = np.zeros((48, 64, 3), np.uint8)
    upright[:24, :32], upright[:, 56:] = 255, (255, 0, 0)
    found = decode_image(data)
    assert found.shape == upright.shape and np.abs(found.astype(int) - upright).mean() < 4


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 2), (48, 64, 3), (48, 64, 4)])
def test_grey_and_colour_of_heic_become_rgb(shape, monkeypatch):
    """libheif gives a monochrome picture two dimensions; it was called damaged."""
    pixels = np.arange(np.prod(shape), dtype=np.uint64).reshape(shape).astype(np.uint8)
    decoder = SimpleNamespace(open_heif=lambda file, convert_hdr_to_8bit: pixels)
    monkeypatch.setitem(sys.modules, "pi_heif", decoder)
    assert np.shape(decode_pixels(heic(64, 48), cv2.IMREAD_COLOR)) == (48, 64, 3), "backgrounds are read so"
    colours = pixels.reshape(48, 64, -1)
    expected = colours[..., :3] if colours.shape[2] > 2 else colours[..., :1].repeat(3, axis=2)
    np.testing.assert_array_equal(decode_image(heic(64, 48)), expected)


@pytest.mark.skipif(not FIELD.is_dir(), reason="../shared/field is not here")
def test_the_pictures_from_the_field():
    """Cases 10 and 11 of its README: a telephone's folder, and a picture of 2^30 pixels."""
    for path in list_images(FIELD / "10-telephone-folder"):
        if path.suffix in (".jpg", ".jfif", ".tif") or cv2.haveImageWriter(".avif"):
            assert min(read_image(path).shape[:2]) >= 270
    with pytest.raises(InputError, match="too large: 40000x30000"):
        read_image(FIELD / "11-gigapixel-background" / "panorama.png")
