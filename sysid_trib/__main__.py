"""`python -m sysid_trib`."""

from sysid_trib.cli import main

main()
