"""openapi.yaml -> a C file that defines rn_openapi_json (see openapi.h)."""
import json
import sys

import yaml

source, target = sys.argv[1:]
with open(source, encoding="utf-8") as stream:
    text = json.dumps(yaml.safe_load(stream), separators=(",", ":")).encode()
rows = [",".join(map(str, text[i:i + 24])) for i in range(0, len(text), 24)]
with open(target, "w", encoding="ascii") as stream:
    stream.write('#include "proto/openapi.h"\nconst char rn_openapi_json[] = {\n')
    stream.write(",\n".join(rows))
    stream.write(",0};\n")
