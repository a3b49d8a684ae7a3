"""Tables as earlier versions wrote them: without some columns, and without a seal."""

import json

import pyarrow.parquet as pq


def as_earlier(path, without=()):
    """Write a table anew as a version had it that knew neither some columns nor a seal."""
    table = pq.read_table(path).drop_columns([*without])
    told = json.loads(table.schema.metadata[b"calibench"])
    told.pop("sealed")
    pq.write_table(table.replace_schema_metadata({"calibench": json.dumps(told)}), path)
