from sysid_trib.datasets.fetching import files as files
from sysid_trib.datasets.registry import names as names, table as table
from sysid_trib.datasets.scoring import score as score, truth as truth
from sysid_trib.records.by_name import load as load
