"""Deep copies of adapters and cores in tests: importing this allows copies of read-only mappings."""

import copyreg
from types import MappingProxyType

# A configuration holds read-only mappings, which copy.deepcopy() cannot copy by itself.
copyreg.pickle(MappingProxyType, lambda mapping: (MappingProxyType, (dict(mapping),)))
