import sysconfig

from setuptools import find_packages, setup

# the extension keeps to the stable interface of the oldest Python that pyproject.toml allows, and the wheel
# says so; a Python without the global lock has no such interface
free_threaded = sysconfig.get_config_var("Py_GIL_DISABLED")

setup(
    cffi_modules=["native/build_ffi.py:ffibuilder"],
    packages=sorted({*find_packages("src"), "zoo.models"}),
    package_dir={"": "src", "zoo.models": "models"},
    options={} if free_threaded else {"bdist_wheel": {"py_limited_api": "cp311"}},
)
