"""Builds the extension module with CMake, which knows what the library is made of, and puts beside it the shared libraries
that it needs, so that a wheel works where none of them is installed.

SALTUS_CMAKE_BUILD=DIR in the environment takes a build directory of CMake's, such as build/release, in place of one of
its own.
"""

import os
import pathlib
import re
import shutil
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = pathlib.Path(__file__).resolve().parent


# Every Linux that runs Python has these, of glibc and of GCC: the manylinux standards (PEP 600) leave them to the system.
SYSTEM = re.compile(r"(lib(c|m|dl|rt|pthread|util|resolv|gcc_s|stdc\+\+)\.so|ld-linux)")


def needed(files):
    """Returns the paths, by name, of the shared libraries that the files need at any depth, without those of the system."""
    listed = subprocess.run(["ldd", *files], capture_output=True, text=True, check=True).stdout
    if missing := re.findall(r"^\s+(\S+) => not found", listed, re.M):
        raise RuntimeError(f"the wheel needs {', '.join(missing)}, which ldd does not find; install the packages that have them")
    return {name: path for name, path in re.findall(r"^\s+(\S+) => (/\S+)", listed, re.M) if not SYSTEM.match(name)}


def package_of(path):
    """Returns the name of the Debian package that has a file; None if no package has it."""
    for spelling in (path, path.removeprefix("/usr")):  # /lib is a link to /usr/lib
        found = subprocess.run(["dpkg", "-S", spelling], capture_output=True, text=True)
        if found.returncode == 0:
            return found.stdout.split(":")[0]
    return None


def bundle(files, folder):
    """Copies what the files need into a folder, with the licences of the packages that it comes from."""
    shutil.rmtree(folder, ignore_errors=True)  # where a build before this one has left it, ldd finds it
    folder.mkdir()
    for name, path in needed(files).items():
        if name.startswith("libsaltus"):
            continue
        real = str(pathlib.Path(path).resolve())
        shutil.copyfile(real, folder / name)
        package = package_of(real) if shutil.which("dpkg") else None
        licence = pathlib.Path(f"/usr/share/doc/{package}/copyright")
        if licence.exists():
            shutil.copyfile(licence, folder / f"{package}.copyright")
        find_neighbours(folder / name)


def find_neighbours(library):
    """Has a library look for others beside itself where it has a folder of this machine for that, as those of Open MPI have."""
    listed = subprocess.run(["readelf", "-d", library], capture_output=True, text=True, check=True).stdout
    if not re.search(r"(RUNPATH|RPATH).*\[(?!\$ORIGIN\])", listed):
        return
    if not shutil.which("patchelf"):
        raise RuntimeError(f"the wheel needs patchelf to change where {library.name} looks for libraries; install the package patchelf")
    subprocess.run(["patchelf", "--set-rpath", "$ORIGIN", library], check=True)


class CMakeBuild(build_ext):
    def build_extension(self, ext):
        build = pathlib.Path(os.environ.get("SALTUS_CMAKE_BUILD", ROOT / "build" / "pip")).resolve()
        if not (build / "CMakeCache.txt").exists():
            subprocess.run(
                ["cmake", "-S", ROOT, "-B", build, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release", "-DSALTUS_BUILD_TESTS=OFF",
                 "-DSALTUS_BUILD_PYTHON=ON", "-DBUILD_SHARED_LIBS=OFF", f"-DPython_EXECUTABLE={sys.executable}"],
                check=True,
            )
        subprocess.run(["cmake", "--build", build, "--target", "saltus_python"], check=True)
        (module,) = (build / "python" / "saltus").glob("_saltus.*.so")
        target = pathlib.Path(self.get_ext_fullpath(ext.name))
        self.copy_file(str(module), str(target))
        for library in (build / "src").glob("libsaltus.so.[0-9]"):  # of a build with shared libraries
            self.copy_file(str(library), str(target.with_name(library.name)))
        bundle([target, *target.parent.glob("libsaltus.so.[0-9]")], target.parent / "libs")


setup(
    version=re.search(r"project\(saltus VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1),
    ext_modules=[Extension("saltus._saltus", sources=[])],
    cmdclass={"build_ext": CMakeBuild},
)
