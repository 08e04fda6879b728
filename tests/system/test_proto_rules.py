"""The rules of proto/buf.yaml: breaches of style, and changes that break a released contract, are reported."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

PROTO = Path(__file__).resolve().parents[2] / "proto"
BUF = Path(sys.executable).with_name("buf")
LINT = ("lint",)
FORMAT = ("format", "--diff", "--exit-code")
BREAKING = ("breaking", "--against", "released.binpb")
SHOP = """syntax = "proto3";

package shop.v1;

// A.
enum Colour {
  // B.
  COLOUR_UNSPECIFIED = 0;
}

// C.
message BuyRequest {
  // D.
  Colour colour = 1;
  // E.
  float size_m = 2;
}

// F.
message BuyResponse {}

// G.
service ShopService {
  // H.
  rpc Buy(BuyRequest) returns (BuyResponse);
}
"""
SIZE = "  // E.\n  float size_m = 2;\n"


@pytest.fixture
def shop(tmp_path: Path) -> Path:
    """A released contract with the same rules as ours."""
    shutil.copy(PROTO / "buf.yaml", tmp_path)
    write(tmp_path, SHOP)
    subprocess.run([BUF, "build", "--output", "released.binpb"], cwd=tmp_path, check=True)
    return tmp_path


def write(folder: Path, text: str) -> None:
    path = folder / "shop" / "v1" / "shop.proto"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def complaints(folder: Path, command: tuple[str, ...]) -> str:
    """Buf's output for the protos in a folder; empty if it accepts them."""
    done = subprocess.run([BUF, *command], cwd=folder, capture_output=True, text=True, check=False)
    assert bool(done.returncode) == bool(done.stdout), done.stderr
    return done.stdout


@pytest.mark.parametrize("command", [LINT, FORMAT, BREAKING])
def test_example_and_our_protos_pass(shop: Path, command: tuple[str, ...]) -> None:
    assert complaints(shop, command) == ""
    assert complaints(PROTO, command) == ""


@pytest.mark.parametrize(
    ("command", "given", "broken", "complaint"),
    [
        (LINT, "shop.v1", "shop", "suffixed with a correctly formed version"),
        (LINT, "COLOUR_UNSPECIFIED", "COLOUR_RED", "suffixed with"),
        (LINT, "size_m", "theSize", "lower_snake_case"),
        (LINT, "  // D.\n", "", "should have a non-empty comment"),
        (LINT, "(BuyResponse)", "(BuyRequest)", "should be named"),
        (LINT, "service ShopService", "service Shop", "suffixed with"),
        (FORMAT, "float size_m", "float   size_m", "-  float   size_m"),
        (BREAKING, SIZE, "", "reserving the number"),
        (BREAKING, SIZE, "  reserved 2;\n", "reserving the name"),
        (BREAKING, "float size_m", "double size_m", "changed type"),
        (BREAKING, "float size_m", "repeated float size_m", "changed cardinality"),
        (BREAKING, "size_m = 2", "width_m = 2", "changed name"),
        (BREAKING, "COLOUR_UNSPECIFIED", "COLOUR_NONE", "changed name"),
        (BREAKING, "// F.\nmessage BuyResponse {}\n", "// F.\nmessage Sale {}\n", 'message "BuyResponse" was deleted'),
    ],
)
def test_breach_is_reported(shop: Path, command: tuple[str, ...], given: str, broken: str, complaint: str) -> None:
    assert given in SHOP
    text = SHOP.replace(given, broken)
    write(shop, text.replace("(BuyResponse)", "(Sale)") if "Sale" in broken else text)
    assert complaint in complaints(shop, command)


def test_field_may_go_if_its_number_and_name_are_reserved(shop: Path) -> None:
    write(shop, SHOP.replace(SIZE, '  reserved 2;\n  reserved "size_m";\n'))
    assert complaints(shop, BREAKING) == ""
