"""Access options for a store at a URL, given by a user in addition to those in environment variables.

Options are ``storage_options``, in the words of obstore or of fsspec, or an obstore store. A backend keeps the options
as values, which can be sent to workers, and creates its own clients from the values. A client tries each request once.
"""

import base64
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from atlas.errors import InputError, brief_repr

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
"""Names of the setting with a server's address: ``_ENDPOINTS`` in the environment, ``_HERE`` in the options of users.
"""
SYNONYMS = {"anon": "skip_signature", "anonymous": "skip_signature"}
"""Options as fsspec's file systems name them, with the names that obstore uses."""
S3_SYNONYMS = SYNONYMS | {"key": "access_key_id", "secret": "secret_access_key", "token": "session_token"}
_CLIENT, _PROVIDER = "client_options", "credential_provider"
_URLS = {"S3Store": "s3://{bucket}", "GCSStore": "gs://{bucket}", "AzureStore": "az://{container_name}"}
"""URL of the bucket of an obstore store, by the store's class; the braces name entries of its configuration."""

Pairs = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class StorageAccess:
    """Options of access to a server, in addition to the environment; they may contain secrets, so they are never
    printed.

    config     settings of the store, by obstore's names
    client     settings of its HTTP client
    provider   provider of credentials; None if there is none
    """

    config: Pairs = field(default=(), repr=False)
    client: Pairs = field(default=(), repr=False)
    provider: Any = field(default=None, repr=False)

    def open_client(self, url: str, settings: Mapping[str, str]) -> "ObjectStore":
        """Return an obstore client of a URL. ``settings`` are environment variables; the client tries each request
        once.
        """
        from obstore.store import from_url

        config, options = dict(self.config), _thawed(self.client)
        known = [url, *(settings[name] for name in _ENDPOINTS if name in settings)]
        known += [str(config[name]) for name in _HERE if name in config]
        if any(text.startswith("http://") for text in known):
            options = {"allow_http": True} | options  # a URL says http explicitly
        all_arguments = {"config": config, _CLIENT: options, _PROVIDER: self.provider}
        arguments: dict[str, Any] = {name: value for name, value in all_arguments.items() if value}
        return from_url(url, retry_config={"max_retries": 0}, **arguments)


BY_ENVIRONMENT = StorageAccess()
"""Access by the settings of the environment alone."""


def access_by(options: Mapping[str, Any], url: str) -> StorageAccess:
    """Return the access given by ``storage_options`` for a URL. Raise InputError for invalid options.

    Options have obstore's names (``endpoint``, ``region``, ``access_key_id``, ``skip_signature``), or the names of
    fsspec's file systems (``anon``; for S3 ``key``, ``secret`` and ``token``).
    """
    if not isinstance(options, Mapping) or not all(isinstance(name, str) for name in options):
        raise InputError(f"storage_options: found {brief_repr(options)}, must be settings by name, such as anon=True")
    words = S3_SYNONYMS if url.startswith(("s3://", "s3a://")) else SYNONYMS
    config: dict[str, Any] = {}
    for option, value in options.items():
        if option in (_CLIENT, _PROVIDER):
            continue
        name = words.get(option, option)
        if name in config:
            raise InputError(f"storage_options: {option} and another name of {name} are given; give one")
        if not isinstance(value, str | int | float | bool):
            raise InputError(f"storage_options: {option}: must be a text, a number, or true or false")  # may be secret
        config[name] = value if isinstance(value, str | bool) else str(value)
    client = options.get(_CLIENT, {})
    if not isinstance(client, Mapping):
        raise InputError(f"storage_options: {_CLIENT}: found {brief_repr(client)}, must be settings by name")
    return StorageAccess(_frozen(config), _frozen(client), options.get(_PROVIDER))


def signed_in(url: str, access: StorageAccess) -> tuple[str, StorageAccess]:
    """Move user and password from a URL into an HTTP header; return the URL without them, and the access with the
    header.

    Browsers and curl send user and password to web servers in this way. Raise InputError if the URL of a bucket has a
    user or a password, since no client reads them there.
    """
    parts = urlsplit(url)
    user, sign, host = parts.netloc.rpartition("@")
    if not sign:
        return url, access
    if parts.scheme not in ("http", "https"):
        raise InputError(f"{url}: has a user or a password, which must be in storage_options or in the environment")
    client = _thawed(access.client)
    basic = "Basic " + base64.b64encode(unquote(user).encode()).decode()
    client["default_headers"] = {"authorization": basic} | client.get("default_headers", {})
    return parts._replace(netloc=host).geturl(), replace(access, client=_frozen(client))


def is_obstore(store: object) -> bool:
    """Return True if ``store`` is an obstore store, without loading obstore."""
    module = sys.modules.get("obstore.store")
    return module is not None and isinstance(store, module.ObjectStore)


def access_of(store: Any) -> tuple[str, StorageAccess]:
    """Return the URL and the access of an obstore store. Raise InputError if it is not the store of a server.

    Retries configured in the store are left out: they hide whether an earlier attempt at a write took effect.
    """
    kind = type(store).__name__
    if kind == "HTTPStore":
        return str(store.url).rstrip("/"), StorageAccess((), _frozen(store.client_options or {}))
    if kind not in _URLS:
        raise InputError(
            f"{store}: not a store of a server; give a path, a URL, or an obstore store of S3, Google or Azure"
        )
    config = dict(store.config)
    url = _URLS[kind].format(**config)
    config = {name: value for name, value in config.items() if name not in ("bucket", "container_name")}
    prefix = str(store.prefix or "").strip("/")
    access = StorageAccess(_frozen(config), _frozen(store.client_options or {}), store.credential_provider)
    return f"{url}/{prefix}" if prefix else url, access


def local_folder(store: Any) -> Path | None:
    """Return the folder of an obstore LocalStore; None for any other store.

    Raise InputError for a LocalStore of the whole disk.
    """
    if type(store).__name__ != "LocalStore":
        return None
    if store.prefix is None:
        raise InputError(f"{store}: is the whole disk; give a path or a LocalStore of a folder")
    return Path(store.prefix).absolute()


def _frozen(settings: Mapping[str, Any]) -> Pairs:
    """Convert settings, nested ones too, to pairs (name, value) sorted by name, which can be hashed and compared."""
    pairs = ((name, _frozen(value) if isinstance(value, Mapping) else value) for name, value in settings.items())
    return tuple(sorted(pairs, key=lambda pair: pair[0]))


def _thawed(pairs: Pairs) -> dict[str, Any]:
    return {name: _thawed(value) if isinstance(value, tuple) else value for name, value in pairs}
