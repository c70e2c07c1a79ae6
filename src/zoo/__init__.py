"""Bayesian calibration of simulators, and the diagnosis of what they miss; with nine models of blood flow.

The names that users import stand in ``__init__.pyi``. Each is loaded when it is first used, so that importing
this package takes a moment and not the seconds that PyMC needs.
"""

import logging

import lazy_loader

# That there is no C++ compiler, which the solver does not need: `zoo doctor` says so.
logging.getLogger("pytensor.configdefaults").addFilter(lambda said: "g++ not" not in said.getMessage())

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
