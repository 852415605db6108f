"""Builds the extension module with CMake, which knows what the library is made of.

SALTUS_CMAKE_BUILD=DIR in the environment takes a build directory of CMake's, such as build/release, in place of one of
its own.
"""

import os
import pathlib
import re
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = pathlib.Path(__file__).resolve().parent


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


setup(
    version=re.search(r"project\(saltus VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text()).group(1),
    ext_modules=[Extension("saltus._saltus", sources=[])],
    cmdclass={"build_ext": CMakeBuild},
)
