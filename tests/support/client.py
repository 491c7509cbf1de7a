"""The command line as a test sees it."""

import json
import os
import subprocess

OK, FAILED, USAGE, NOT_FOUND, INVALID, CANCELLED, UNREACHABLE, UNAUTHORISED = range(8)


class Client:
    def __init__(self, program, cwd, url):
        self.program, self.cwd = str(program), cwd
        self.environment = {"PATH": os.environ["PATH"], "RIPNERF_HOST": url}

    def command(self, *arguments):
        return [self.program, *map(str, arguments)]

    def run(self, *arguments, code=OK, **environment):
        result = subprocess.run(self.command(*arguments), cwd=self.cwd, text=True,
                                capture_output=True, timeout=900, check=False,
                                stdin=subprocess.DEVNULL, env=self.environment | environment)
        assert code is None or result.returncode == code, result.stdout + result.stderr
        return result

    def json(self, *arguments, code=OK):
        return json.loads(self.run(*arguments, "--json", code=code).stdout)

    def start(self, *arguments):
        return subprocess.Popen(self.command(*arguments), cwd=self.cwd, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                                stdin=subprocess.DEVNULL, env=self.environment)
