from ..averaging.identifiability import indistinguishable as indistinguishable
from ..averaging.signatures import signature as signature
from ..regression.pysindy_features import ForceFeatures as ForceFeatures
from .force import Force as Force, ForceLibrary as ForceLibrary
