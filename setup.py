import sysconfig

from setuptools import find_packages, setup

# the extension keeps to the stable interface of the oldest Python that pyproject.toml allows, and the wheel
# says so; a Python without the global lock has no such interface
free_threaded = sysconfig.get_config_var("Py_GIL_DISABLED")

setup(
    cffi_modules=["native/build_ffi.py:ffibuilder"],
    packages=find_packages("src"),  # src/zoo/models is a link to models
    package_dir={"": "src"},
    options={} if free_threaded else {"bdist_wheel": {"py_limited_api": "cp311"}},
)
