"""What users import, with the modules that define it: type checkers and `lazy_loader` read this file.

A name is loaded when it is first used. `name as name` is how a stub exports a name.
"""
# ruff: noqa: I001

# Data, priors and forward models of any simulator
from .core.data import Data as Data
from .core.data import DataError as DataError
from .core.errors.base import ErrorModel as ErrorModel
from .core.errors.gaussian_process import GaussianProcess as GaussianProcess
from .core.errors.groups import GroupNoise as GroupNoise
from .core.errors.groups import GroupProcess as GroupProcess
from .core.errors.independent import Independent as Independent
from .core.errors.spectral import Cosines as Cosines
from .core.errors.spectral import Harmonics as Harmonics
from .core.errors.spectral import Uneven as Uneven
from .core.errors.student import GroupStudent as GroupStudent
from .core.forward import ForwardModel as ForwardModel
from .core.forward import FunctionModel as FunctionModel
from .core.forward import Outputs as Outputs
from .core.experiments import ExperimentError as ExperimentError
from .core.forward import SolveError as SolveError
from .core.forward import from_pints as from_pints
from .core.parameters import Parameter as Parameter
from .core.parameters import draw_prior as draw_prior
from .core.parameters import pack as pack
from .core.parameters import start_of as start_of
from .core.priors import InverseGamma as InverseGamma
from .core.priors import LogNormal as LogNormal
from .core.priors import LogPopulation as LogPopulation
from .core.priors import LogUniform as LogUniform
from .core.priors import Normal as Normal
from .core.priors import ParameterError as ParameterError
from .core.priors import Population as Population
from .core.priors import Prior as Prior
from .core.priors import Uniform as Uniform

# What a simulator may lack
from .core.components import free_function as free_function
from .core.effects import Effect as Effect
from .core.effects import EffectError as EffectError
from .core.effects import EffectParameter as EffectParameter
from .core.effects import Location as Location
from .core.effects import effect as effect
from .core.effects import with_effects as with_effects

# Diagnoses
from .core.blindcheck import DrawnCase as DrawnCase
from .core.blindcheck import ModelDraw as ModelDraw
from .core.blindcheck import Score as Score
from .core.blindcheck import blind_check as blind_check
from .core.diagnosis import Candidate as Candidate
from .core.diagnosis import Diagnosis as Diagnosis
from .core.diagnosis import DiagnosisError as DiagnosisError
from .core.diagnosis import Hooks as Hooks
from .core.diagnosis import OtherState as OtherState
from .core.diagnosis import read_diagnosis as read_diagnosis
from .report.diagnosis_page import write_diagnosis as write_diagnosis
from .front import diagnose as diagnose

# Studies of blood flow
from .blood.conventions import PRINTED as PRINTED
from .blood.conventions import PUBLISHED_CODE as PUBLISHED_CODE
from .blood.conventions import Conventions as Conventions
from .blood.conventions import get_conventions as get_conventions
from .blood.fetch import FetchError as FetchError
from .blood.fetch import fetch_dataset as fetch_dataset
from .blood.fetch import fetch_file as fetch_file
from .blood.importing.beats import import_beats as import_beats
from .blood.importing.imported import ImportedFileError as ImportedFileError
from .blood.importing.openbf import import_openbf as import_openbf
from .blood.importing.study_beats import average_beats as average_beats
from .blood.importing.svonedsolver import import_svonedsolver as import_svonedsolver
from .blood.importing.svzerodsolver import import_svzerodsolver as import_svzerodsolver
from .blood.importing.table import import_table as import_table
from .blood.importing.vampy import import_vampy as import_vampy
from .blood.network import Network as Network
from .blood.solver import Solver as Solver
from .blood.solver import SolverError as SolverError
from .blood.solver import SolverOptions as SolverOptions
from .blood.study import Blood as Blood
from .blood.study import Series as Series
from .blood.study import Study as Study
from .blood.study import StudyError as StudyError
from .blood.study import UnitWarning as UnitWarning
from .blood.study import Vessel as Vessel
from .blood.study import even_samples as even_samples
from .blood.study import list_studies as list_studies
from .blood.study import load_study as load_study
from .blood.study import save_study as save_study
from .blood.study import suspect_units as suspect_units

# Effects on blood flow
from .blood.case import Case as Case
from .blood.case import members as members
from .blood.case import with_offset as with_offset
from .blood.case import with_physics as with_physics
from .blood.case import with_wave as with_wave
from .blood.effects.given import added_effects as added_effects
from .blood.effects.locations import each_vessel as each_vessel
from .blood.effects.measures import BEATS as BEATS
from .blood.impedance import measured_impedance as measured_impedance
from .blood.impedance import modelled_impedance as modelled_impedance

# Models of a study
from .blood.baseline import Baseline as Baseline
from .blood.baseline import get_baseline as get_baseline
from .blood.baseline import study_model as study_model
from .blood.errors import by_prior_set as by_prior_set
from .blood.blood_flow import scaled_stiffness as scaled_stiffness
from .blood.blood_flow import study_data as study_data
from .blood.plugins import get_model as get_model
from .blood.plugins import load_models as load_models
from .models.model_a import model_A as model_A
from .models.model_b import model_B as model_B
from .models.model_c import model_C as model_C
from .models.model_d import model_D as model_D
from .models.model_e import model_E as model_E
from .models.model_f import model_F as model_F
from .models.model_g import model_G as model_G
from .models.model_h import model_H as model_H
from .models.model_i import model_I as model_I

# Posteriors and their comparison
from .blood.predictive import predictive_draws as predictive_draws
from .core.inference.cluster import connect as connect
from .core.inference.convergence import diagnostics as diagnostics
from .core.inference.convergence import verdict as verdict
from .core.inference.mode import find_mode as find_mode
from .core.inference.pymc_step import step as step
from .core.inference.record import RunRecord as RunRecord
from .core.joint import by_subject as by_subject
from .core.joint import joint_model as joint_model
from .core.joint import of_subject as of_subject
from .core.inference.pymc_step import bayesian_model as bayesian_model
from .core.posterior.comparison import compare as compare
from .core.posterior.comparison import loo_pit as loo_pit
from .core.posterior.comparison import posterior_means as posterior_means
from .core.posterior.files import PosteriorError as PosteriorError
from .core.posterior.files import load_posterior as load_posterior
from .core.posterior.arviz_groups import add_groups as add_groups
from .core.posterior.arviz_groups import by_place as by_place
from .core.posterior.arviz_groups import sample as sample
from .core.posterior.storage import save_posterior as save_posterior
from .core.posterior.storage import slim_posterior as slim_posterior

__version__: str
