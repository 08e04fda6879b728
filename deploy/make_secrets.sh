#!/bin/sh
# Create the secrets that deploy/compose.yaml needs, in deploy/secrets (never commit them): a certificate authority with
# certificates for proxy, servers and encoder, tokens with the file of their hashes, and passwords. Needs OpenSSL 3, and
# motiongen-server to create the tokens:
#   deploy/make_secrets.sh                     # where motiongen-server is installed
#   IDENTITY=".venv/bin/python -m motiongen_server.identity" deploy/make_secrets.sh    # after make setup
#   IDENTITY="docker run --rm --entrypoint python motiongen-server:cpu -m motiongen_server.identity" deploy/make_secrets.sh
# NAMES: the names under which clients reach the proxy (default: DNS:localhost,IP:127.0.0.1).
set -eu
identity=${IDENTITY:-python -m motiongen_server.identity}
names=${NAMES:-DNS:localhost,IP:127.0.0.1}
usage() {
    echo "usage: $0 [FOLDER]"
    sed -n '2,/^set -eu/s/^# \{0,1\}//p' "$0"
}
case ${1-} in
-h | --help)
    usage
    exit 0
    ;;
-*)
    usage >&2
    exit 2
    ;;
esac
if [ $# -gt 1 ]; then
    usage >&2
    exit 2
fi
folder=${1:-$(dirname "$0")/secrets}
if [ -e "$folder" ]; then
    echo "$folder exists already; remove it to create new secrets" >&2
    exit 1
fi
# Check this before creating anything: a half-made folder would be in the way the next time.
if ! $identity --help > /dev/null 2>&1; then
    echo "cannot create tokens with: $identity" >&2
    echo "install motiongen-server, or set IDENTITY to a command that creates them, as at the top of $0" >&2
    exit 1
fi
# The folder is closed to other users; the files in it are readable, because the containers' users read them when mounted.
mkdir -m 700 "$folder"
here=$(pwd)
cd "$folder"
folder=$(pwd)
trap 'status=$?; if [ $status -ne 0 ]; then cat openssl.log entry >&2 2> /dev/null; rm -rf "$folder"; fi' EXIT
# Without these, a signal ends some shells without running the EXIT trap above.
trap 'exit 129' HUP
trap 'exit 130' INT
trap 'exit 143' TERM
umask 022

key="-newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc"
# shellcheck disable=SC2086
openssl req -x509 $key -days 3650 -subj "/CN=motiongen deployment" -keyout authority.key -out authority.pem 2> openssl.log
leaf() { # name, alternative names
    # shellcheck disable=SC2086
    openssl req $key -subj "/CN=$1" -keyout "$1.key" -out request.pem 2>> openssl.log
    printf 'subjectAltName=%s\nbasicConstraints=critical,CA:FALSE\n' "$2" > extensions
    openssl x509 -req -in request.pem -CA authority.pem -CAkey authority.key -days 825 -extfile extensions \
        -out "$1.pem" 2>> openssl.log
    chmod 644 "$1.key"
    rm request.pem extensions
}
leaf server "DNS:server-a,DNS:server-b,DNS:encoder,DNS:localhost"
leaf proxy "$names"
cat proxy.pem proxy.key > proxy-with-key.pem

token() { # tenant, role
    # In the folder where this script was started, because IDENTITY may be relative to it.
    (cd "$here" && exec $identity "$1") > "$1.token" 2> entry
    sed -n '/^\[tenants/,$p' entry >> tenants.toml # without what a container engine prints before it
    printf 'roles = ["%s"]\n\n' "$2" >> tenants.toml
    rm entry
}
: > tenants.toml
token player motion
token prometheus metrics
token servers text

openssl rand -hex 24 > redis-password
openssl rand -hex 24 > grafana-password
echo "MOTIONGEN_SNAPSHOT_STORE=redis://:$(cat redis-password)@redis:6379/0" > store.env
chmod 600 authority.key
rm openssl.log
echo "created $folder; clients need player.token and authority.pem from it"
