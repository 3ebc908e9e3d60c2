#!/bin/sh
# an authority, and a certificate for each of the three; the names matter, the access list uses them
openssl req -x509 -newkey rsa:2048 -nodes -days 365 -subj "/CN=fleet" -keyout ca.key -out ca.pem
for name in service tablet office; do
  openssl req -newkey rsa:2048 -nodes -subj "/CN=$name" -keyout $name.key -out $name.csr
  printf 'subjectAltName=DNS:localhost,IP:127.0.0.1' > $name.ext
  openssl x509 -req -in $name.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 365 -extfile $name.ext -out $name.pem
done
