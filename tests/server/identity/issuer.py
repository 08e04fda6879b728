"""An issuer for tests: it signs tokens with real keys, and publishes its public keys over HTTP."""

from __future__ import annotations

import json
import ssl
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import jwt
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from jwt.algorithms import ECAlgorithm, OKPAlgorithm, RSAAlgorithm

NAME = "https://login.example"
LIFE_S = 3600


@cache
def private_key(algorithm: str, name: str) -> Any:
    """The private key of a name, generated once and then reused."""
    if algorithm == "ES256":
        return ec.generate_private_key(ec.SECP256R1())
    return (
        rsa.generate_private_key(65537, 2048) if algorithm[:2] in ("RS", "PS") else ed25519.Ed25519PrivateKey.generate()
    )


def public_pem(algorithm: str, name: str) -> bytes:
    """The public key as PEM."""
    public = private_key(algorithm, name).public_key()
    pem: bytes = public.public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    return pem


class Issuer:
    """keys: algorithm by key name; all are published. url: the address at which it is `served`."""

    def __init__(self, **keys: str) -> None:
        self.keys = keys or {"first": "ES256"}
        self.is_down = False
        self.asked = 0
        self.url = ""

    def document(self) -> dict[str, Any]:
        """The JSON key set with all its public keys."""
        return {"keys": [self._public(name, algorithm) for name, algorithm in self.keys.items()]}

    @staticmethod
    def _public(name: str, algorithm: str) -> dict[str, Any]:
        kinds = {"RS256": RSAAlgorithm, "PS256": RSAAlgorithm, "ES256": ECAlgorithm, "EdDSA": OKPAlgorithm}
        told = kinds[algorithm].to_jwk(private_key(algorithm, name).public_key(), as_dict=True)
        return {**told, "kid": name, "alg": algorithm, "use": "sig"}

    def token(self, key: str = "first", algorithm: str = "ES256", kid: str | None = None, **claims: Any) -> str:
        """A valid token with some claims replaced; a claim that is None is left out.

        kid: the key's name in the token's header, "" to leave it out; by default, the key's own name.
        """
        now = int(time.time())
        usual = {"iss": NAME, "aud": "motiongen", "iat": now, "exp": now + LIFE_S, "tenant": "studio"}
        said = {name: value for name, value in {**usual, **claims}.items() if value is not None}
        signed_with = private_key(self.keys.get(key, algorithm), key)  # an RSA key signs with any RSA algorithm
        named = key if kid is None else kid
        return jwt.encode(said, signed_with, algorithm, {"kid": named} if named else None)

    @contextmanager
    def served(self, tls: ssl.SSLContext | None = None) -> Iterator[None]:
        """Publish the keys at `url`, over https if a TLS context is given."""
        issuer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                issuer.asked += 1
                answer = issuer.answer(self.path)
                self.send_response(503 if issuer.is_down else 200)
                self.end_headers()
                self.wfile.write(json.dumps(answer).encode())

            def log_message(self, *_: Any) -> None:
                pass

        with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
            if tls is not None:
                server.socket = tls.wrap_socket(server.socket, server_side=True)
            thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
            thread.start()
            self.url = f"{'http' if tls is None else 'https'}://localhost:{server.server_port}"
            try:
                yield
            finally:
                server.shutdown()
                thread.join()

    def answer(self, path: str) -> dict[str, Any]:
        """The document that it serves at a path."""
        if path.endswith("openid-configuration"):
            return {"issuer": self.url, "jwks_uri": f"{self.url}/jwks"}
        return self.document()

    def entry(self, keys: str, more: str = "", tenant: str = "issuers = ['corp']") -> str:
        """The content of a file of tenants that accepts its tokens."""
        return (
            f"[issuers.corp]\nissuer = '{NAME}'\naudience = ['motiongen']\nkeys = '{keys}'\n"
            f"algorithms = ['ES256', 'RS256', 'EdDSA']\n{more}\n[tenants.studio]\n{tenant}\n"
        )
