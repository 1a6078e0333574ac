"""Small input files, written by hand, and a PNG reader. Standard library only."""

import base64
import json
import math
import struct
import zlib
from pathlib import Path


def write_png(path, width, height, pixel, bits=8):
    """pixel(x, y) -> (r, g, b) codes."""
    rows = b""
    for y in range(height):
        codes = [c for x in range(width) for c in pixel(x, y)]
        rows += b"\0" + struct.pack(f">{len(codes)}{'B' if bits == 8 else 'H'}", *codes)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    Path(path).write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) +
                           chunk(b"IEND", b""))


def read_png(path):
    """(width, height, bytes of RGB) of an 8-bit RGB PNG."""
    data, at, packed, header = Path(path).read_bytes(), 8, b"", None
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + length]
        at += 12 + length
        if kind == b"IHDR":
            header = struct.unpack(">IIBBBBB", body)
        if kind == b"IDAT":
            packed += body
    width, height, bits, colour = header[:4]
    assert (bits, colour) == (8, 2), header
    raw, stride = zlib.decompress(packed), 3 * width
    above, out = bytearray(stride), bytearray()
    for y in range(height):
        start = y * (stride + 1)
        above = unfilter(raw[start], bytearray(raw[start + 1:start + 1 + stride]), above)
        out += above
    return width, height, bytes(out)


def unfilter(kind, row, above):
    """PNG specification, section 9."""
    for i in range(len(row)):
        a, b, c = (row[i - 3] if i >= 3 else 0), above[i], (above[i - 3] if i >= 3 else 0)
        if kind == 1:
            guess = a
        elif kind == 2:
            guess = b
        elif kind == 3:
            guess = (a + b) // 2
        elif kind == 4:
            p = a + b - c
            guess = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))[2]
        else:
            guess = 0
        row[i] = (row[i] + guess) & 255
    return row


def write_hdr(path, width, height, rgb):
    """A constant picture as flat RGBE."""
    mantissa, exponent = math.frexp(max(rgb))
    scale = mantissa * 256 / max(rgb) if any(rgb) else 0
    pixel = bytes([int(c * scale) for c in rgb] + [exponent + 128 if any(rgb) else 0])
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + pixel * (width * height))


def write_sun_hdr(path, width, height, sun):
    """Radiance 1 everywhere but in one pixel, high to the right, as flat RGBE."""
    mantissa, exponent = math.frexp(sun)
    pixels = bytearray(bytes([128, 128, 128, 129]) * (width * height))
    at = 4 * (height // 4 * width + width * 5 // 8)
    pixels[at:at + 4] = bytes([int(mantissa * 256)] * 3 + [exponent + 128])
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + bytes(pixels))


def write_slope_hdr(path, width, height):
    """Six stops from left to right with a texture, as flat RGBE."""
    pixels = bytearray()
    for y in range(height):
        for x in range(width):
            mantissa, exponent = math.frexp(2 ** (6 * x / width) * (1 + 0.1 * math.sin(0.7 * x + 0.4 * y)))
            pixels += bytes([int(mantissa * part) for part in (256, 200, 120)] + [exponent + 128])
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + bytes(pixels))


def write_lamp_hdr(path, width, height, lamp):
    """Black but for one pixel, as flat RGBE."""
    exponent = math.frexp(max(lamp))[1]
    pixels = bytearray(4 * width * height)
    at = 4 * (height // 2 * width + width // 2)
    pixels[at:at + 4] = bytes([int(v * 256 / 2 ** exponent) for v in lamp] + [exponent + 128])
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + bytes(pixels))


def write_card_hdr(path, width, height, card, wall):
    """A grey card over the left eighth, a grey wall over the rest, as flat RGBE."""
    def pixel(grey):
        mantissa, exponent = math.frexp(grey)
        return bytes([int(mantissa * 256)] * 3 + [exponent + 128])
    row = pixel(card) * (width // 8) + pixel(wall) * (width - width // 8)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + row * height)


def write_striped_hdr(path, width, height):
    """A sky of stripes by height, 0.125 and 2, over a ground of 8, as flat RGBE."""
    codes = {.125: (128, 126), 8: (128, 132), 2: (128, 130)}
    rows = [8 if 2 * y >= height else 2 if y % 32 < 16 else .125 for y in range(height)]
    pixels = b"".join(bytes([codes[v][0]] * 3 + [codes[v][1]]) * width for v in rows)
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    Path(path).write_bytes(head + pixels)


def write_mirror(path):
    """Two squares of polished metal: one that lies flat, one beside it that stands, as glTF."""
    corners = struct.pack("<24f", -.3, .01, -.3, -.3, .01, .3, .3, .01, .3, .3, .01, -.3,
                          .4, .01, -.3, .9, .01, -.3, .9, .5, -.3, .4, .5, -.3)
    data = base64.b64encode(corners + struct.pack("<12H", 0, 1, 2, 0, 2, 3, 4, 5, 6, 4, 6, 7)).decode()
    metal = {"name": "mirror", "pbrMetallicRoughness": {"baseColorFactor": [.9, .9, .9, 1], "roughnessFactor": 0.05}}
    Path(path).write_text(json.dumps({
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "materials": [metal],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 8},
                      {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 12}],
        "bufferViews": [{"buffer": 0, "byteLength": 96}, {"buffer": 0, "byteOffset": 96, "byteLength": 24}],
        "buffers": [{"byteLength": 120, "uri": f"data:application/octet-stream;base64,{data}"}]}))


CUBE = """v -0.2 0 -0.2
v 0.2 0 -0.2
v 0.2 0 0.2
v -0.2 0 0.2
v -0.2 0.4 -0.2
v 0.2 0.4 -0.2
v 0.2 0.4 0.2
v -0.2 0.4 0.2
f 1 2 3
f 1 3 4
f 5 7 6
f 5 8 7
f 1 6 2
f 1 5 6
f 2 7 3
f 2 6 7
f 3 8 4
f 3 7 8
f 4 5 1
f 4 8 5
"""

SCENE = """version = 1
[[object]]
name = "cube"
asset = "cube.obj"
albedo = [0.6, 0.6, 0.6]
[[real]]
plane = { point = [0, 0, 0], normal = [0, 1, 0] }
albedo = [0.4, 0.4, 0.4]
"""

# 1.2 m high, 2 m away, looking down by half a radian.
CAMERA = """version = 1
[[camera]]
name = "view"
role = "view"
width = 64
height = 48
projection = "pinhole"
focal_px = [60, 60]
world_from_camera = [1,0,0,0, 0,0.87758256,-0.47942554,0, 0,0.47942554,0.87758256,0, 0,1.2,2,1]
"""


def write_scene(folder):
    (folder / "cube.obj").write_text(CUBE)
    (folder / "scene.toml").write_text(SCENE)
    (folder / "camera.toml").write_text(CAMERA)


CAPTURE = """version = 1
[[camera]]
name = "environment"
role = "environment"
width = 32
height = 16
projection = "latlong"
response = "srgb"
black_level = 0.0
world_from_camera = [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,1,0,1]
frames = "environment.csv"
[[camera]]
name = "view"
role = "view"
width = 64
height = 48
projection = "pinhole"
focal_px = [60, 60]
response = "srgb"
black_level = 0.0
world_from_camera = [1,0,0,0, 0,0.87758256,-0.47942554,0, 0,0.47942554,0.87758256,0, 0,1.2,2,1]
frames = "view.csv"
"""


def add_depth(folder, depth_mm):
    """A depth camera beside the view of write_capture(); depth_mm(x, y) of 32 x 24 pixels."""
    (folder / "depth").mkdir()
    pose = CAPTURE.rstrip().splitlines()[-2]
    with (folder / "capture.toml").open("a", encoding="utf-8") as out:
        out.write('[[camera]]\nname = "depth"\nrole = "depth"\nwidth = 32\nheight = 24\nprojection = "pinhole"\n'
                  f'focal_px = [30, 30]\n{pose}\nframes = "depth.csv"\n')
    write_png(folder / "depth" / "0.png", 32, 24, lambda x, y: 3 * (depth_mm(x, y),), bits=16)
    (folder / "depth.csv").write_text("file,time_s,exposure_s,gain\ndepth/0.png,0.04,0.01,1\n")


def write_capture(folder, codes=(60, 160), exposures=("0.01", "0.04")):
    """Two environment exposures of a grey room and three view frames."""
    for name in ("environment", "view"):
        (folder / name).mkdir(parents=True)
    (folder / "capture.toml").write_text(CAPTURE)
    rows = "file,time_s,exposure_s,gain\n"
    for i, (code, exposure) in enumerate(zip(codes, exposures)):
        write_png(folder / "environment" / f"{i}.png", 32, 16, lambda x, y, c=code: (c, c, c))
        rows += f"environment/{i}.png,{i * 0.03},{exposure},1\n"
    (folder / "environment.csv").write_text(rows)
    rows = "file,time_s,exposure_s,gain\n"
    for i in range(3):
        write_png(folder / "view" / f"{i}.png", 64, 48, lambda x, y, i=i: ((7 * x + i) % 256, 5 * y, (x * y) % 256))
        rows += f"view/{i}.png,{0.04 + i * 0.03},0.02,1\n"
    (folder / "view.csv").write_text(rows)
