"""The published schema of report.json: real documents keep it, it describes all they hold, and broken ones fail."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from evaluation.report import Report, report_schema, to_json
from evaluation.report.report import SCHEMA
from tests.fixtures.known_models import Broken, Known, Sliding, fitted
from tests.fixtures.reports import make_report, matrix, prediction, report

WITHOUT_ROBOT = {"linear": {"linear": 12.0, "sindy": 11.0}, "sindy": {"linear": 9.0, "sindy": 10.0}}


@pytest.fixture(scope="module")
def whole() -> Report:
    return make_report({"known": fitted(Known()), "sliding": fitted(Sliding()), "broken": fitted(Broken())})


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    schema = report_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def faults(validator: jsonschema.Draft202012Validator, document: dict[str, Any]) -> list[str]:
    return [f"{error.json_path}: {error.message}" for error in validator.iter_errors(document)]


def undescribed(value: Any, schema: dict[str, Any], definitions: dict[str, Any], path: str = "$") -> Iterator[str]:
    """Yield the keys of a document that its schema does not name."""
    if "anyOf" in schema:
        schema = schema["anyOf"][0]
    if "$ref" in schema:
        schema = definitions[schema["$ref"].rpartition("/")[2]]
    if isinstance(value, dict):
        others = schema.get("additionalProperties")
        for key, item in value.items():
            if key in schema.get("properties", {}):
                yield from undescribed(item, schema["properties"][key], definitions, f"{path}.{key}")
            elif isinstance(others, dict):
                yield from undescribed(item, others, definitions, f"{path}.{key}")
            elif others is not True:
                yield f"{path}.{key}"
    elif isinstance(value, list) and "items" in schema:
        for item in value:
            yield from undescribed(item, schema["items"], definitions, f"{path}[]")


def test_every_kind_of_report_keeps_the_schema(whole: Report, validator: jsonschema.Draft202012Validator) -> None:
    found = prediction({"persistence": 0.9, "linear": 0.3}, {"linear": 0.4}, failed=["sindy"])
    for made in (whole, report(), report(found, failures=2), report(found, matrix(WITHOUT_ROBOT))):
        assert faults(validator, to_json(made)) == []


def test_the_schema_names_every_key(whole: Report) -> None:
    schema = report_schema()
    assert sorted(set(undescribed(to_json(whole), schema, schema["$defs"]))) == []


def test_a_document_that_lacks_a_key_or_has_another_kind_of_value_is_refused(
    whole: Report, validator: jsonschema.Draft202012Validator
) -> None:
    document = to_json(whole)
    for key in document:
        less = copy.copy(document)
        del less[key]
        assert any(f"'{key}' is a required property" in fault for fault in faults(validator, less))
    for change in ({"title": 3}, {"schema": "sysid-evo/report/1"}, {"failures": [{"what": "fit"}]}, {"transfer": []}):
        assert faults(validator, {**document, **change})


def test_the_schema_and_the_document_have_the_same_number() -> None:
    schema = report_schema()
    assert schema["properties"]["schema"]["const"] == SCHEMA
    assert schema["$id"].endswith(SCHEMA.rpartition("/")[2])
