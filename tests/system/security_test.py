"""Who has no business here does not get in: TLS, certificates and tokens through the real programs, and the HTTP port."""

import contextlib
import http.client
import json
import os
import socket
import ssl
import subprocess
import unittest

from programs import BIN, DRIVES, SOURCE, ProgramTest, run, start_pose

SHORT = DRIVES / "short.mcap"


class SecurityTest(ProgramTest):
    def setUp(self):
        super().setUp()
        self.keys = self.folder / "keys"
        self.credentials("dev", self.keys)

    def credentials(self, *arguments):
        subprocess.run([SOURCE / "deploy" / "credentials", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)

    def secure_server(self, *arguments):
        return self.server("data", "--tls-cert", self.keys / "server.pem", "--tls-key", self.keys / "server-key.pem", "--tls-client-ca",
                           self.keys / "ca.pem", "--tokens", self.keys / "tokens.toml", *arguments)

    def as_token(self, name):
        return ["--tls-ca", self.keys / "ca.pem", "--token-file", self.keys / f"{name}.token"]

    def as_robot(self, name):
        return ["--tls-ca", self.keys / "ca.pem", "--tls-cert", self.keys / f"{name}.pem", "--tls-key", self.keys / f"{name}-key.pem"]

    def replay(self, site, robot, *credentials, **options):
        pose = start_pose(DRIVES / "mapping.mcap")
        return ["replay", DRIVES / "mapping.mcap", "--site", site, "--robot", robot, "--purpose", "mapping", "--speed", "max",
                f"--initial-pose={pose}", "--connect-timeout", "2", *credentials]

    def test_apps_by_token_robots_by_certificate(self):
        self.credentials("robot", self.keys, "r1", "plant")
        self.credentials("token", self.keys, "other", "admin", "other")
        server = self.secure_server("--audit-log", self.folder / "audit")
        self.ok(server, "soundmap", *self.as_token("admin"), "site", "create", "plant")
        self.refused(server, "soundmap", *self.as_token("read"), "site", "create", "hall", says="token read may not administrate")
        self.refused(server, "soundmap", *self.as_token("other"), "site", "show", "plant", says="may not read at site 'plant'")
        self.refused(server, "soundmap", "--tls-ca", self.keys / "ca.pem", "site", "list", says="neither a token nor")
        self.refused(server, "soundmap", "site", "list", says="")  # plain text

        self.refused(server, "soundmap-robot", *self.replay("plant", "r2", *self.as_robot("r1")), says="may not send drives as robot 'r2'")
        self.refused(server, "soundmap-robot", *self.replay("hall", "r1", *self.as_robot("r1")), says="site 'hall'")
        self.refused(server, "soundmap-robot", *self.replay("plant", "r1", "--tls-ca", self.keys / "ca.pem"), says="neither a token nor")
        self.ok(server, "soundmap-robot", *self.replay("plant", "r1", *self.as_robot("r1")))
        self.ok(server, "soundmap", *self.as_token("write"), "map", "build", "plant")
        self.assertIn("plant", self.ok(server, "soundmap", *self.as_token("read"), "site", "list"))
        self.ok(server, "soundmap", *self.as_token("read"), "sources", "plant")
        self.assertEqual(server.stop(), 0)

        lines = [json.loads(line) for line in (self.folder / "audit").read_text().splitlines()]
        told = {(line["who"], line["deed"], line["result"]) for line in lines}
        self.assertIn(("token admin", "create site", "OK"), told)
        self.assertIn(("token read", "create site", "PERMISSION_DENIED"), told)
        self.assertIn(("robot r1", "create session", "OK"), told)
        self.assertIn(("robot r1", "create session", "PERMISSION_DENIED"), told)
        self.assertIn(("token write", "build map", "OK"), told)

    def https(self, server, path, *, token=None, method="GET", context=None):
        context = context or ssl.create_default_context(cafile=self.keys / "ca.pem")
        host, port = server.http_address.rsplit(":", 1)
        connection = http.client.HTTPSConnection(host, int(port), context=context, timeout=30)
        headers = {"Authorization": "Bearer " + (self.keys / f"{token}.token").read_text().strip()} if token else {}
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        body = response.read().decode()
        version = connection.sock.version() if connection.sock else None
        connection.close()
        return response.status, body, version

    def test_the_http_port(self):
        server = self.secure_server()
        self.assertEqual(self.https(server, "/livez")[::2], (200, "TLSv1.3"))
        self.assertEqual(self.https(server, "/readyz")[0], 200)
        self.assertEqual(self.https(server, "/metrics")[0], 401)
        status, body, _ = self.https(server, "/metrics", token="read")
        self.assertEqual(status, 200)
        self.assertIn('soundmap_refused_calls_total{reason="unauthenticated"} 1', body)
        for path in ("/../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/metrics/../../etc/passwd", "/metrics%00"):
            self.assertEqual(self.https(server, path, token="admin")[0], 404, path)
        self.assertEqual(self.https(server, "/metrics", token="read", method="DELETE")[0], 405)

        old = ssl.create_default_context(cafile=self.keys / "ca.pem")
        old.maximum_version = ssl.TLSVersion.TLSv1_2
        with self.assertRaises(OSError):
            self.https(server, "/livez", context=old)
        with self.assertRaises(ssl.SSLCertVerificationError):
            self.https(server, "/livez", context=ssl.create_default_context())

        # Too much and too odd, in plain text and inside TLS; the port goes on.
        host, port = server.http_address.rsplit(":", 1)
        trusted = ssl.create_default_context(cafile=self.keys / "ca.pem")
        for sent in (b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * 100_000, b"POST /metrics HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n",
                     b"\x00" * 10_000, b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", b"GET /" + b"x" * 100_000):
            for secure in (False, True):
                with socket.create_connection((host, int(port)), timeout=30) as raw:
                    with contextlib.suppress(OSError), trusted.wrap_socket(raw, server_hostname=host) if secure else raw as connection:
                        connection.sendall(sent)
                        while connection.recv(1 << 16):
                            pass
        self.assertEqual(self.https(server, "/livez")[0], 200)

        # Those who keep their connection open do not hold the server up.
        for secure in (False, True):
            raw = socket.create_connection((host, int(port)), timeout=30)
            self.addCleanup((trusted.wrap_socket(raw, server_hostname=host) if secure else raw).close)
        self.assertEqual(server.stop(within_s=10), 0)

    def test_the_certificate_of_the_http_port_is_read_again(self):
        server = self.secure_server()
        self.assertEqual(self.https(server, "/livez")[0], 200)
        new = self.folder / "new"
        self.credentials("ca", new)
        self.credentials("server", new, "127.0.0.1")
        for name in ("server-key.pem", "server.pem"):
            os.replace(new / name, self.keys / name)
        context = ssl.create_default_context(cafile=new / "ca.pem")
        for _ in range(10_000):
            try:
                self.assertEqual(self.https(server, "/livez", context=context)[0], 200)
                return
            except ssl.SSLCertVerificationError:
                pass
        self.fail("the old certificate is served still")

    def start_refused(self, *arguments, says):
        addresses = {"--grpc": "127.0.0.1:0", "--http": "127.0.0.1:0"}
        free = [text for flag, address in addresses.items() if flag not in arguments for text in (flag, address)]
        result = subprocess.run([BIN / "soundmap-server", "--data-dir", self.folder / "other", "--log-level", "off", *free, *arguments],
                                capture_output=True, text=True, timeout=60)
        self.assertIn(result.returncode, (1, 2), result.stderr)
        self.assertEqual(len(result.stderr.strip().splitlines()), 1, result.stderr)
        self.assertIn(says, result.stderr)

    def test_a_server_that_would_let_anybody_in_does_not_start(self):
        tls = ["--tls-cert", self.keys / "server.pem", "--tls-key", self.keys / "server-key.pem"]
        self.start_refused("--grpc", "0.0.0.0:0", says="--tls-cert")
        self.start_refused("--http", "0.0.0.0:0", says="--tls-cert")
        self.start_refused("--grpc", "0.0.0.0:0", *tls, says="--tokens")
        self.start_refused("--tls-cert", self.keys / "server.pem", says="go together")
        self.start_refused("--tls-client-ca", self.keys / "ca.pem", says="--tls-client-ca needs")
        self.start_refused("--tls-cert", self.keys / "ca.pem", "--tls-key", self.keys / "server-key.pem", says="server-key.pem")
        self.start_refused("--tokens", self.keys / "ca.pem", says="ca.pem")
        self.start_refused("--tokens", self.keys / "missing.toml", says="missing.toml")

    def test_tokens_on_loopback_without_tls(self):
        server = self.server("data", "--tokens", self.keys / "tokens.toml")
        self.refused(server, "soundmap", "site", "list", says="no token was shown")
        self.ok(server, "soundmap", "--token-file", self.keys / "admin.token", "site", "create", "plant")
        # The administrator takes a token away.
        tokens = self.keys / "tokens.toml"
        (self.keys / "next").write_text(tokens.read_text().split("[[token]]\nname = \"write\"")[0])
        os.replace(self.keys / "next", tokens)
        arguments = ["--token-file", self.keys / "read.token", "sources", "plant"]
        for _ in range(10_000):
            if run(server, "soundmap", *arguments).returncode != 0:
                break
        self.refused(server, "soundmap", *arguments, says="the token is not known")
        self.ok(server, "soundmap", "--token-file", self.keys / "admin.token", "sources", "plant")


if __name__ == "__main__":
    unittest.main()
