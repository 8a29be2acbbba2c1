#!/bin/sh
# Makes a certificate authority and one certificate per role, for trials and tests; a mission uses its own authority.
# Usage: make-certificates.sh DIRECTORY [HOST]      HOST: name or IPv4 address the service is reached at (127.0.0.1)
# Written: ca.pem, and NAME.pem with NAME.key for magcal-service, magcal-feeder, magcal-operator, magcal-viewer.
# The role is the certificate's common name: that is what the access control in config/zenoh-tls.json5 goes by.
set -eu

[ $# -ge 1 ] || { echo "usage: $0 DIRECTORY [HOST]" >&2; exit 2; }
command -v openssl >/dev/null || { echo "$0: openssl is missing; install it with: apt install openssl" >&2; exit 2; }
directory=$1
host=${2:-127.0.0.1}
days=825
case $host in
    *[!0-9.]*) san="DNS:$host" ;;
    *) san="IP:$host" ;;
esac

[ ! -e "$directory/ca.key" ] || { echo "$0: $directory/ca.key exists; remove it or name another directory" >&2; exit 2; }
mkdir -p "$directory"
cd "$directory"
umask 077
trap 'rm -f request.cnf ca.srl ./*.csr ./*.ext' EXIT

key() { openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1.key"; }

cat >request.cnf <<END
[req]
distinguished_name = name
prompt = no
[name]
[authority]
basicConstraints = critical, CA:TRUE, pathlen:0
keyUsage = critical, keyCertSign, cRLSign
subjectKeyIdentifier = hash
END

key ca
openssl req -x509 -new -key ca.key -days "$days" -subj "/CN=magcal trial authority" -out ca.pem \
    -config request.cnf -extensions authority

for role in service feeder operator viewer; do
    name=magcal-$role
    case $role in
        service) names=$san ;;
        *) names=DNS:$name ;;
    esac
    cat >"$name.ext" <<END
basicConstraints = critical, CA:FALSE
keyUsage = critical, digitalSignature
extendedKeyUsage = serverAuth, clientAuth
subjectAltName = $names
END
    key "$name"
    openssl req -new -key "$name.key" -subj "/CN=$name" -config request.cnf -out "$name.csr"
    openssl x509 -req -in "$name.csr" -CA ca.pem -CAkey ca.key -CAcreateserial -days "$days" \
        -extfile "$name.ext" -out "$name.pem" 2>/dev/null
done
chmod 644 ./*.pem
