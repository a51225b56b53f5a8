from sysid_trib.campaigns.between_records import between_runs as between_runs

from .conditions import estimates_of as estimates_of
from .store import open_store as open_store
from .task import Task as Task
