"""A line to a server that is slow and loses requests: each waits, and every so many are cut off unanswered."""

import re
import socket
import threading
import time


class LossyLine:
    """`with LossyLine(port, latency_s, lost) as line:` listens on line.port.

    lost: share of requests; they are evenly spaced, so that chance fails no test.
    """

    def __init__(self, target_port, latency_s, lost):
        self.target_port, self.latency_s, self.every = target_port, latency_s, round(1 / lost)
        self.lock = threading.Lock()
        self.requests = self.cut = 0
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]

    def __enter__(self):
        threading.Thread(target=self.serve, daemon=True).start()
        return self

    def __exit__(self, *_):
        self.server.close()

    def serve(self):
        while True:
            try:
                client, _ = self.server.accept()
            except OSError:
                return
            threading.Thread(target=self.carry, args=(client,), daemon=True).start()

    def is_lost(self):
        with self.lock:
            self.requests += 1
            lost = self.requests % self.every == 0
            self.cut += lost
            return lost

    def carry(self, client):
        """One request a connection, so that the end of an answer is the end of the line."""
        with client:
            head = b""
            try:
                while b"\r\n\r\n" not in head:
                    part = client.recv(65536)
                    if not part:
                        return
                    head += part
                head, body = head.split(b"\r\n\r\n", 1)
                time.sleep(self.latency_s)
                if self.is_lost():
                    return
                self.exchange(client, head, body)
            except OSError:
                pass

    def exchange(self, client, head, body):
        size = re.search(rb"(?i)^content-length: *(\d+)", head, re.MULTILINE)
        left = int(size[1]) - len(body) if size else 0
        head = re.sub(rb"(?im)^(connection|expect):.*\r\n", b"", head + b"\r\n")
        # the page is told by the Host that it asked for, and so is the daemon
        with socket.create_connection(("127.0.0.1", self.target_port)) as server:
            server.sendall(head + b"Connection: close\r\n\r\n" + body)
            while left > 0:
                part = client.recv(min(left, 65536))
                if not part:
                    return
                server.sendall(part)
                left -= len(part)
            while part := server.recv(65536):
                client.sendall(part)
