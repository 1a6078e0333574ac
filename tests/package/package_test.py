#!/usr/bin/env python3
"""Installs Penumbra into a folder and uses it from a project outside of the tree, as a stranger would.

usage: package_test.py BUILD_FOLDER EXAMPLES_FOLDER PROGRAM CXX
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path


def run(*command, **keywords):
    done = subprocess.run([str(c) for c in command], text=True, capture_output=True, **keywords)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}: {done.returncode}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def version_of(build):
    """As libraries of the same interface have it: "0.1" of 0.1.0."""
    cache = (Path(build) / "CMakeCache.txt").read_text()
    return re.search(r"^CMAKE_PROJECT_VERSION:STATIC=(\d+\.\d+)", cache, re.M)[1]


def check(truth, what):
    if not truth:
        sys.exit(f"package_test: {what}")


def check_headers(prefix, folder, compiler, flags):
    """Each installed header can be included, all of them together."""
    include = prefix / "include"
    (folder / "all.cpp").write_text("".join(f"#include <{file.relative_to(include)}>\n"
                                            for file in sorted(include.rglob("*.h"))))
    run(compiler, "-fsyntax-only", folder / "all.cpp", *flags)
    hidden = [str(file.relative_to(include)) for file in sorted(include.rglob("*.h"))
              if not is_header_of_templates_or_c(file) and not shows_what_it_declares(file.read_text())]
    check(not hidden, f"declare what the shared library hides: {hidden}")


def shows_what_it_declares(header):
    """Or includes alone."""
    declares = any(line and not line.startswith(("#", "//", " ")) for line in header.splitlines())
    return not declares or "#pragma GCC visibility push(default)" in header


def is_header_of_templates_or_c(file):
    return file.parent.name == "client" or file.name == "cow_vector.h"


def check_installed(files, folder, examples, environment, lines, library):
    """The packages can be installed on this Debian, and what they put there serves and runs."""
    root = folder / "root"
    for file in files:
        run("dpkg-deb", "--extract", file, root)
    # A dependency that this Debian does not have fails here.
    plan = run("apt-get", "install", "--simulate", "--no-install-recommends", *files)
    for name in (library, "penumbra-dev", "penumbra-tools"):
        check(f"Inst {name} " in plan or f"{name} is already" in plan,
              f"apt would not install {name}:\n{plan}")
    installed = environment | {"LD_LIBRARY_PATH": str(next(root.rglob("libpenumbra.so")).parent)}
    version = run(root / "usr/bin/penumbra", "--version", env=installed)
    check(library.removeprefix("libpenumbra") in version, f"the installed program says {version!r}")
    run(root / "usr/bin/penumbra", "demo", "--headless", "--frames", "1", "--width", "160", "--height",
        "90", "--asset", "builtin:box", "--no-turntable", "--no-video", "--out", folder / "installed",
        env=installed)
    check((folder / "installed" / "still.png").stat().st_size > 1000,
          "the installed programs draw no demo")
    run("cmake", "-S", examples, "-B", folder / "against", f"-DCMAKE_PREFIX_PATH={root}/usr",
        "-DCMAKE_BUILD_TYPE=Release", "-DEXAMPLES_ALL=OFF", env=installed)
    run("cmake", "--build", folder / "against")
    check(run(folder / "against" / "light").splitlines() == lines,
          "what is built against the packages prints another light")


def check_packages(build, folder, library):
    """Makes the Debian packages and looks into them; returns their files."""
    run("cpack", "-G", "DEB", "--config", Path(build) / "CPackConfig.cmake", "-B", folder / "packages")
    packages = {}
    archives = sorted((folder / "packages").glob("*.deb"))
    for file in archives:
        name = run("dpkg-deb", "--field", file, "Package").strip()
        packages[name] = run("dpkg-deb", "--field", file, "Depends"), run("dpkg-deb", "--contents", file)
    check(sorted(packages) == [library, "penumbra-dev", "penumbra-tools"],
          f"the packages are {sorted(packages)}")
    for name, files in ((library, [f"/libpenumbra.so.{version_of(build)}", "/libpenumbra_client.so.0",
                                  "/api_layers/explicit.d/XrApiLayer_penumbra_light.json",
                                  "/penumbra/libpenumbra_openxr_layer.so"]),
                        ("penumbra-dev", ["/penumbra/runtime/pipeline/pipeline.h", "/penumbraConfig.cmake",
                                          "/pkgconfig/penumbra.pc", "/libpenumbra_lighting.a",
                                          "/penumbra/client/penumbra_client.h"]),
                        ("penumbra-tools", ["/bin/penumbra\n", "/bin/penumbrad\n", "/man1/penumbra.1",
                                            "/completions/penumbra\n", "/systemd/system/penumbrad.service",
                                            "/sysusers.d/penumbra.conf", "/penumbra/rig.toml"])):
        depends, contents = packages[name]
        for file in files:
            check(file in contents, f"{name} has no {file.strip()}")
        check("/internal/" not in contents, f"{name} has private headers")
        wanted = library if name == "penumbra-dev" else "libc6"
        check(wanted in depends, f"{name} does not depend on {wanted}: {depends}")
    return archives


COMPONENTS = "client core codec camera calib capture devices lighting prt shadows compositor runtime".split()


def check_components(prefix, folder, environment):
    """Each component alone: what the package files look for is enough to link it. Targets that are
    found in one folder are not known in another, so that folders of one project do."""
    head = "cmake_minimum_required(VERSION 3.25)\nproject(one CXX)\n"

    def build(name, components):
        (folder / name).mkdir()
        (folder / name / "main.cpp").write_text("int main() {}\n")
        (folder / name / "CMakeLists.txt").write_text(head + "".join(f"add_subdirectory({c})\n" for c in components))
        for component in components:
            (folder / name / component).mkdir()
            (folder / name / component / "CMakeLists.txt").write_text(
                f"find_package(penumbra REQUIRED COMPONENTS {component})\n"
                f"add_executable({component} ../main.cpp)\n"
                f"target_link_libraries({component} PRIVATE penumbra::{component})\n")
        run("cmake", "-S", folder / name, "-B", folder / name / "build", f"-DCMAKE_PREFIX_PATH={prefix}",
            env=environment)
        run("cmake", "--build", folder / name / "build", "--parallel", "2")
        return (folder / name / "build" / "CMakeCache.txt").read_text()

    build("each", COMPONENTS)
    light, codec = build("light", ["camera"]), build("pictures", ["codec"])
    check("OpenCV_DIR" not in light and "OpenEXR_DIR" not in light,
          "the component camera looks for OpenCV or OpenEXR")
    check("OpenCV_DIR" not in codec, "the component codec looks for OpenCV")


def main(build, examples, program, compiler):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        prefix, tree = folder / "prefix", folder / "build"
        run("cmake", "--build", build, "--target", "penumbra_shared")
        run("cmake", "--install", build, "--prefix", prefix)
        environment = os.environ | {"CXX": compiler}

        (folder / "one").mkdir()
        check_components(prefix, folder / "one", environment)

        # The light alone: nothing of cameras, rays or pictures is looked for or linked.
        run("cmake", "-S", examples, "-B", tree, f"-DCMAKE_PREFIX_PATH={prefix}",
            "-DCMAKE_BUILD_TYPE=Release", "-DEXAMPLES_ALL=OFF", env=environment)
        run("cmake", "--build", tree)
        lines = run(tree / "light").splitlines()
        check(len(lines) == 26, f"light.cpp prints 25 coefficients and a sun, not {lines}")
        check(lines[-1].startswith("light towards"), f"light.cpp finds no sun: {lines[-1]}")
        linked = run("ldd", tree / "light")
        for library in ("opencv", "ceres", "embree", "avcodec", "EGL"):
            check(library not in linked, f"light.cpp links {library}:\n{linked}")

        # pkg-config serves the same example.
        def flags_of(package):
            return run("pkg-config", "--cflags", "--libs", package, env=os.environ | {
                "PKG_CONFIG_PATH": str(next(prefix.rglob("pkgconfig")))}).split()

        flags = flags_of("penumbra-lighting")
        # A program's own core/result.h is not ours, and ours is not the program's.
        (folder / "core").mkdir()
        (folder / "core" / "result.h").write_text("#error the program's own\n")
        run(compiler, Path(examples) / "light.cpp", "-o", folder / "light", f"-I{folder}", *flags)
        check(run(folder / "light").splitlines() == lines, "pkg-config builds another light")

        # The whole: a bake, and a recording through the pipeline.
        run("cmake", "-S", examples, "-B", tree, "-DEXAMPLES_ALL=ON", env=environment)
        run("cmake", "--build", tree, "--parallel", "2")
        mesh = folder / "box.obj"
        mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
        run(tree / "bake", mesh, folder / "box.glb")
        check((folder / "box.glb").stat().st_size > 1000, "bake.cpp writes an object")
        cache = os.environ | {"XDG_CACHE_HOME": os.environ.get("PENUMBRA_TEST_BAKES", str(folder / "cache"))}
        run(program, "demo", "--fine", "--headless", "--frames", "4", "--width", "160", "--height", "90",
            "--asset", "builtin:box", "--no-turntable", "--no-video", "--record", folder / "capture",
            "--out", folder / "out", env=cache)
        run(tree / "composite", folder / "capture", folder / "capture" / "scene.toml",
            folder / "picture.png", env=cache)
        picture = (folder / "picture.png").read_bytes()
        check(picture[:8] == b"\x89PNG\r\n\x1a\n", "composite.cpp writes a picture")
        check(picture == (folder / "out" / "still.png").read_bytes(),
              "composite.cpp draws what the demo drew last")

        # The shared library shows what public headers declare, and draws the same picture.
        library = next(prefix.rglob("libpenumbra.so"))
        shown = run("nm", "-DC", "--defined-only", library)
        check("penumbra::Pipeline::create(" in shown, "libpenumbra.so shows no Pipeline")
        check("penumbra::set_log_sink(" in shown, "libpenumbra.so shows no set_log_sink")
        check("penumbra::compositor::Layers" not in shown, "libpenumbra.so shows a private class")
        check("tinygltf::" not in shown, "libpenumbra.so shows another library's code")
        run(compiler, Path(examples) / "composite.cpp", "-o", folder / "shared", *flags_of("penumbra"))
        check_headers(prefix, folder, compiler, flags_of("penumbra"))
        run(folder / "shared", folder / "capture", folder / "capture" / "scene.toml",
            folder / "shared.png", env=cache | {"LD_LIBRARY_PATH": str(library.parent)})
        check((folder / "shared.png").read_bytes() == picture,
              "the shared library draws another picture")

        # Programs come with their manual and completion.
        manual = next(prefix.rglob("penumbra.1")).read_text()
        check("\\-\\-max\\-lights" in manual, "penumbra.1 tells the flags")
        completion = next(prefix.rglob("bash-completion/completions/penumbra")).read_text()
        check("--max-lights" in completion, "completion knows the flags")
        names = run("bash", "-c", "source " + str(next(prefix.rglob("completions/penumbra"))) +
                    "; COMP_WORDS=(penumbra dem); COMP_CWORD=1; _penumbra; echo ${COMPREPLY[@]}")
        check(names.split() == ["demo"], f"completion of 'penumbra dem' is {names!r}")
        library = f"libpenumbra{version_of(build)}"
        check_installed(check_packages(build, folder, library), folder, examples, environment | cache,
                        lines, library)
    print("installed, linked and run from outside of the tree")


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
