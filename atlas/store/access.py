"""Access options of a URL, where a user gives more than the environment.

By ``storage_options`` in the words of obstore or of fsspec, or by an obstore store given as an object. A place keeps
this as values, so that it crosses to workers, and makes clients of its own from them: these try everything once.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from atlas.errors import InputError, shown

if TYPE_CHECKING:
    from obstore.store import ObjectStore

_ENDPOINTS = ("AWS_ENDPOINT_URL", "AWS_ENDPOINT", "GOOGLE_BASE_URL", "AZURE_STORAGE_ENDPOINT", "AZURE_ENDPOINT")
_HERE = (
    "endpoint",
    "endpoint_url",
    "aws_endpoint",
    "aws_endpoint_url",
    "azure_storage_endpoint",
    "google_base_url",
    "base_url",
)
"""What an endpoint is called in the environment, and by users."""
SYNONYMS = {"anon": "skip_signature", "anonymous": "skip_signature"}
"""Words of fsspec's file systems, with obstore's word."""
S3_SYNONYMS = SYNONYMS | {"key": "access_key_id", "secret": "secret_access_key", "token": "session_token"}
_CLIENT, _PROVIDER = "client_options", "credential_provider"
_URLS = {"S3Store": "s3://{bucket}", "GCSStore": "gs://{bucket}", "AzureStore": "az://{container_name}"}
"""The URL of what an obstore store is of, by its configuration."""

Pairs = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Access:
    """What is said beyond the environment; of secrets too, so that it is never printed.

    config     settings of the store, by obstore's names
    client     settings of its HTTP client
    provider   what gives credentials, None for none
    """

    config: Pairs = field(default=(), repr=False)
    client: Pairs = field(default=(), repr=False)
    provider: Any = field(default=None, repr=False)

    def make(self, url: str, settings: Mapping[str, str]) -> "ObjectStore":
        """The client of a URL, under these settings of the environment. It tries everything once."""
        from obstore.store import from_url

        config, options = dict(self.config), _thawed(self.client)
        known = [url, *(settings[name] for name in _ENDPOINTS if name in settings)]
        known += [str(config[name]) for name in _HERE if name in config]
        if any(text.startswith("http://") for text in known):
            options = {"allow_http": True} | options  # a URL says http explicitly
        wanted = {"config": config, _CLIENT: options, _PROVIDER: self.provider}
        given: dict[str, Any] = {name: each for name, each in wanted.items() if each}
        return from_url(url, retry_config={"max_retries": 0}, **given)


BY_ENVIRONMENT = Access()
"""Nothing more than that is said."""


def access_by(options: Mapping[str, Any], url: str) -> Access:
    """The access that ``storage_options`` ask for at a URL; InputError for what cannot be one.

    Settings are called as obstore calls them (``endpoint``, ``region``, ``access_key_id``, ``skip_signature``), or as
    fsspec's file systems do (``anon``; at S3 ``key``, ``secret`` and ``token``).
    """
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise InputError(f"storage_options: found {shown(options)}, must be settings by name, such as anon=True")
    words = S3_SYNONYMS if url.startswith(("s3://", "s3a://")) else SYNONYMS
    config: dict[str, Any] = {}
    for given, value in options.items():
        if given in (_CLIENT, _PROVIDER):
            continue
        name = words.get(given, given)
        if name in config:
            raise InputError(f"storage_options: {given} and another name of {name} are given; give one")
        if not isinstance(value, str | int | float | bool):
            raise InputError(f"storage_options: {given}: must be a text, a number, or true or false")  # may be secret
        config[name] = value if isinstance(value, str | bool) else str(value)
    client = options.get(_CLIENT, {})
    if not isinstance(client, Mapping):
        raise InputError(f"storage_options: {_CLIENT}: found {shown(client)}, must be settings by name")
    return Access(_frozen(config), _frozen(client), options.get(_PROVIDER))


def is_obstore(store: object) -> bool:
    """Whether this is one of obstore's stores; obstore is not loaded for it."""
    module = sys.modules.get("obstore.store")
    return module is not None and isinstance(store, module.ObjectStore)


def access_of(store: Any) -> tuple[str, Access]:
    """The URL of an obstore store, and how it is reached. InputError if it is of no server.

    Its own retries are left out: they do not tell whether a write may have had its effect before.
    """
    kind = type(store).__name__
    if kind == "HTTPStore":
        return str(store.url).rstrip("/"), Access((), _frozen(store.client_options or {}))
    if kind not in _URLS:
        raise InputError(f"{store}: is of no server; give a path, a URL, or an obstore store of S3, Google or Azure")
    config = dict(store.config)
    url = _URLS[kind].format(**config)
    config = {name: value for name, value in config.items() if name not in ("bucket", "container_name")}
    prefix = str(store.prefix or "").strip("/")
    found = Access(_frozen(config), _frozen(store.client_options or {}), store.credential_provider)
    return f"{url}/{prefix}" if prefix else url, found


def local_folder(store: Any) -> Path | None:
    """The folder of an obstore LocalStore; None for any other. InputError for one of the whole disk."""
    if type(store).__name__ != "LocalStore":
        return None
    if store.prefix is None:
        raise InputError(f"{store}: is the whole disk; give it a folder, or a path in its place")
    return Path(store.prefix).absolute()


def _frozen(given: Mapping[str, Any]) -> Pairs:
    """Settings as pairs, with those inside of them too, so that they are a key."""
    found = ((name, _frozen(value) if isinstance(value, Mapping) else value) for name, value in given.items())
    return tuple(sorted(found, key=lambda pair: pair[0]))


def _thawed(pairs: Pairs) -> dict[str, Any]:
    return {name: _thawed(value) if isinstance(value, tuple) else value for name, value in pairs}
