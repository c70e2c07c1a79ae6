"""Bayesian calibration of simulators, and the diagnosis of what they miss; with nine models of blood flow.

The names that users import stand in ``__init__.pyi``. Each is loaded when it is first used, so that importing
this package takes a moment and not the seconds that PyMC needs.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
