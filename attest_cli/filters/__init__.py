"""Forward filters: nodes in, one :class:`~attest_cli.records.FilterRun` out. Dotted names: a filter is imported when
it is used.
"""

FILTERS = {
    "indirect": "attest_cli.filters.indirect",
}
