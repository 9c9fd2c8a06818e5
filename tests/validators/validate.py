"""Runs the public validators on crates and a signed statement; prints one JSON object a line.

usage: validate.py CRATES_FOLDER STATEMENT PUBLIC_KEY

The JSON-LD context of RO-Crate 1.1 comes from the package `rocrate`; any other address that a validator asks for is refused,
so that the answer does not depend on the network.
"""
import importlib.util, io, json, pathlib, sys

import requests, requests.adapters, urllib3

CONTEXT = "https://w3id.org/ro/crate/1.1/context"


def context_bytes():
    package = importlib.util.find_spec("rocrate").submodule_search_locations[0]
    return (pathlib.Path(package) / "data" / "ro-crate.jsonld").read_bytes()


def send(adapter, request, **_):
    if request.url != CONTEXT:
        raise requests.ConnectionError(f"refused: {request.url}")
    raw = urllib3.HTTPResponse(
        body=io.BytesIO(context_bytes()), headers={"Content-Type": "application/ld+json"}, status=200, preload_content=False
    )
    return adapter.build_response(request, raw)


def say(validator, case, issues):
    print(json.dumps({"validator": validator, "case": case, "passed": not issues, "issues": [str(issue) for issue in issues]}))


def ro_crate(folder):
    from rocrate_validator import models, services

    settings = services.ValidationSettings(
        rocrate_uri=str(folder / "data"),
        profile_identifier="provenance-run-crate",
        requirement_severity=models.Severity.REQUIRED,
    )
    found = services.validate(settings).get_issues()
    return [f"{issue.check.identifier} {issue.message}" for issue in found]


def bag(folder):
    import bagit

    try:
        bagit.Bag(str(folder)).validate()
        return []
    except bagit.BagError as error:
        return [error]


def statement(path, key):
    from cryptography.hazmat.primitives.serialization import load_pem_public_key
    from google.protobuf.json_format import MessageToDict, Parse, ParseDict
    from in_toto_attestation.predicates.provenance.v1 import provenance_pb2
    from in_toto_attestation.v1 import statement_pb2
    from in_toto_attestation.v1.statement import Statement
    from securesystemslib.dsse import Envelope
    from securesystemslib.signer import SSlibKey

    try:
        envelope = Envelope.from_dict(json.loads(pathlib.Path(path).read_text()))
        envelope.verify([SSlibKey.from_crypto(load_pem_public_key(pathlib.Path(key).read_bytes()))], 1)
        read = statement_pb2.Statement()
        Parse(envelope.payload, read)
        Statement.copy_from_pb(read).validate()
        ParseDict(MessageToDict(read.predicate), provenance_pb2.Provenance())
        return []
    except Exception as error:  # whatever a validator throws is its answer
        return [f"{type(error).__name__}: {error}"]


requests.adapters.HTTPAdapter.send = send
for folder in sorted(pathlib.Path(sys.argv[1]).iterdir()):
    say("roc-validator", folder.name, ro_crate(folder))
    say("bagit", folder.name, bag(folder))
say("in-toto", "statement", statement(sys.argv[2], sys.argv[3]))
