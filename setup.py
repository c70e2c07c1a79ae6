from setuptools import find_packages, setup

setup(
    cffi_modules=["native/build_ffi.py:ffibuilder"],
    packages=sorted({*find_packages("src"), "zoo.models"}),
    package_dir={"": "src", "zoo.models": "models"},
)
