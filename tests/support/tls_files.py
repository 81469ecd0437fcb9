"""Certificates for TLS on a bench: a root, the gateway's, a tester's."""

import datetime as dt
from ipaddress import IPv4Address

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID


def _name(common):
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def write_tls(folder, names=("gateway", "workshop")):
    """Write ``ca`` and those of names: certificates (.pem) with their keys (.key)."""
    now, day = dt.datetime.now(dt.UTC), dt.timedelta(days=1)
    root_key = ec.generate_private_key(ec.SECP256R1())
    for common in ("ca", *names):
        key = root_key if common == "ca" else ec.generate_private_key(ec.SECP256R1())
        made = (
            x509.CertificateBuilder()
            .subject_name(_name(common))
            .issuer_name(_name("ca"))
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - day)
            .not_valid_after(now + day)
            .add_extension(x509.SubjectAlternativeName([x509.IPAddress(IPv4Address("127.0.0.1"))]), critical=False)
            .add_extension(x509.BasicConstraints(ca=common == "ca", path_length=None), critical=True)
            .sign(root_key, hashes.SHA256())
        )
        (folder / f"{common}.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
        data = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        (folder / f"{common}.key").write_bytes(data)
        (folder / f"{common}.key").chmod(0o600)
