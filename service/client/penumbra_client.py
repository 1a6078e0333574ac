"""Penumbra's newest light, objects and cube map in Python, by way of libpenumbra_client.

    client = penumbra_client.Client()
    light = client.wait(0)                 # the first one; None after the timeout
    print(light.number, light.coefficients[0][0])

Light, Objects and Cube have the names of the C structs in penumbra_light_page.h; their arrays are
read as lists are, or by numpy.ctypeslib.as_array without a copy. What is returned is the caller's
own. A client belongs to one thread at a time. PENUMBRA_CLIENT_LIBRARY names another library file.
"""
import ctypes
import ctypes.util
import os
from ctypes import POINTER, byref, c_char, c_float, c_int, c_int64, c_uint16, c_uint32, c_uint64

OK, STALE, NONE_YET, BUSY, TIMEOUT, NO_PAGE = 0, 1, -1, -2, -3, -4
WEBXR, ARCORE, GODOT, FILAMENT, UNITY, UNREAL = range(6)
VERSION = 1

Rgb = c_float * 3


class DistantLight(ctypes.Structure):
    _fields_ = [("id", c_uint32), ("direction", c_float * 3), ("radius_rad", c_float),
                ("solid_angle_sr", c_float), ("radiance", Rgb), ("clipped", c_uint32),
                ("lower_bound", c_uint32)]


class Light(ctypes.Structure):
    _fields_ = [("number", c_uint64), ("capture_time_ns", c_int64), ("published_ns", c_int64),
                ("valid", c_uint32), ("lower_bound", c_uint32), ("within_budget", c_uint32),
                ("bands", c_uint32), ("light_count", c_uint32), ("reserved", c_uint32),
                ("coverage", c_float), ("clipped_fraction", c_float),
                ("predicted_shadow_error", c_float), ("mean_radiance", Rgb),
                ("coefficients", Rgb * 81), ("residual", Rgb * 81), ("lights", DistantLight * 64)]
    stale = False  # the daemon that wrote it has ended

    @property
    def age_ns(self):
        """Time since it was published."""
        return _library().penumbra_light_age_ns(byref(self))


class Object(ctypes.Structure):
    _fields_ = [("name", c_char * 64), ("position_m", c_float * 3), ("rotation_wxyz", c_float * 4),
                ("visible", c_uint32)]


class Objects(ctypes.Structure):
    _fields_ = [("number", c_uint64), ("capture_time_ns", c_int64), ("count", c_uint32),
                ("objects", Object * 64), ("reserved", c_uint32)]
    stale = False


class Cube(ctypes.Structure):
    _fields_ = [("number", c_uint64), ("capture_time_ns", c_int64), ("size", c_uint32),
                ("faces", c_uint32), ("texels", c_uint16 * 4 * 64 * 64 * 6)]
    stale = False


class Error(Exception):
    """code: of enum penumbra_code."""

    def __init__(self, code, thing):
        super().__init__(f"{thing}: {_library().penumbra_error_text(code).decode()}")
        self.code = code


_loaded = None


def _library():
    global _loaded
    if _loaded is not None:
        return _loaded
    name = os.environ.get("PENUMBRA_CLIENT_LIBRARY") or ctypes.util.find_library("penumbra_client")
    library = ctypes.CDLL(name or "libpenumbra_client.so.0")
    if (version := library.penumbra_client_version()) != VERSION:
        raise ImportError(f"{library._name}: has version {version}, this module needs {VERSION}")
    library.penumbra_struct_bytes.restype = ctypes.c_size_t
    for which, struct in ((1, Light), (2, Objects), (3, Cube)):
        if (there := library.penumbra_struct_bytes(which)) != ctypes.sizeof(struct):
            raise ImportError(f"{library._name}: {struct.__name__} has {there} bytes there, "
                              f"{ctypes.sizeof(struct)} here")
    client = ctypes.c_void_p
    for function, types in (("open", (ctypes.c_char_p, POINTER(client))), ("close", (client,)),
                            ("light", (client, POINTER(Light))), ("path", (client,)),
                            ("wait", (client, c_uint64, c_int, POINTER(Light))),
                            ("objects", (client, POINTER(Objects))),
                            ("cube", (client, POINTER(Cube)))):
        getattr(library, "penumbra_client_" + function).argtypes = types
    library.penumbra_client_close.restype = None
    library.penumbra_client_path.restype = library.penumbra_error_text.restype = ctypes.c_char_p
    library.penumbra_light_age_ns.argtypes = (POINTER(Light),)
    library.penumbra_light_age_ns.restype = c_int64
    library.penumbra_sh_convert.argtypes = (c_int, POINTER(Rgb), c_int, POINTER(Rgb))
    library.penumbra_direction_convert.argtypes = (c_int, c_float * 3, c_float * 3)
    _loaded = library
    return library


class Client:
    """path: the page's file; None looks where the daemon puts it. Works before the daemon does."""

    def __init__(self, path=None):
        self._client = ctypes.c_void_p()
        code = _library().penumbra_client_open(os.fsencode(path) if path is not None else None,
                                               byref(self._client))
        if not self._client:
            raise Error(code, path or "penumbra")

    def close(self):
        _library().penumbra_client_close(self._client)
        self._client = ctypes.c_void_p()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @property
    def path(self):
        return os.fsdecode(_library().penumbra_client_path(self._client))

    def _read(self, function, out, *arguments, none=(NONE_YET, BUSY, NO_PAGE)):
        code = function(self._client, *arguments, byref(out))
        if code in none:
            return None
        if code < 0:
            raise Error(code, self.path)
        out.stale = code == STALE
        return out

    def light(self):
        """The newest Light; None where there is none yet. Does not wait."""
        return self._read(_library().penumbra_client_light, Light())

    def wait(self, after_number, timeout_ms=-1):
        """The first Light with another number; None when the time is over. Below 0: no end."""
        return self._read(_library().penumbra_client_wait, Light(), after_number, timeout_ms,
                          none=(TIMEOUT, NO_PAGE))

    def objects(self):
        """Where the objects stood in the newest picture; None where there is none yet."""
        return self._read(_library().penumbra_client_objects, Objects())

    def cube(self):
        """The surroundings as a Cube of half floats; None where there is none yet."""
        return self._read(_library().penumbra_client_cube, Cube())


def sh_convert(convention, coefficients, bands):
    """bands*bands rows of RGB as an engine wants them (WEBXR, ARCORE, GODOT, ...)."""
    rows = (Rgb * (bands * bands))(*(Rgb(*coefficients[n]) for n in range(bands * bands)))
    if (code := _library().penumbra_sh_convert(convention, rows, bands, rows)) < 0:
        raise Error(code, "sh_convert")
    return [list(row) for row in rows]


def direction_convert(convention, direction):
    """A vector of the world on the engine's axes."""
    vector = (c_float * 3)(*direction)
    if (code := _library().penumbra_direction_convert(convention, vector, vector)) < 0:
        raise Error(code, "direction_convert")
    return list(vector)
