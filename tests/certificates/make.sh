#!/bin/sh
# Certificates for the tests, good for a hundred years and for nothing else: two of one server, one of a client, and
# one of a client from another authority. Needs OpenSSL 3. Run it here; the tests read what is committed.
set -eu
authority() { # file, name
    openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc -days 36500 -subj "/CN=$2" \
        -keyout "$1.key" -out "$1.pem"
}
leaf() { # file, name, alternative names, authority
    openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -noenc -subj "/CN=$2" -keyout "$1.key" -out request.pem
    printf 'subjectAltName=%s\nbasicConstraints=critical,CA:FALSE\n' "$3" > extensions
    openssl x509 -req -in request.pem -CA "$4.pem" -CAkey "$4.key" -days 36500 -extfile extensions -out "$1.pem"
    rm request.pem extensions
}
authority authority "tests of motiongen"
authority stranger-authority "another authority"
for server in server-1 server-2; do
    leaf "$server" "$server" "DNS:localhost,IP:127.0.0.1,IP:::1" authority
done
leaf client "studio" "DNS:studio.example" authority
leaf stranger "studio" "DNS:studio.example" stranger-authority
rm authority.key stranger-authority.key
