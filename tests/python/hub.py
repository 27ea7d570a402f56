"""A hub on this machine for `.ci/wheel`: prints its address, and keeps what is pushed until it is ended.

It answers the requests of `stance hub`; files of any size come in one piece. `tests/it/hub/server.rs` can also fail.
"""

import base64
import hashlib
import json
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

repos: dict[str, dict[str, bytes]] = {}
commits: dict[str, int] = {}
objects: dict[str, bytes] = {}


def is_large(path: str) -> bool:
    return path.endswith((".parquet", ".safetensors"))


class Hub(BaseHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass

    def reply(self, body: object = b"", status: int = 200) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def body(self) -> bytes:
        return self.rfile.read(int(self.headers.get("Content-Length", 0)))

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server.server_address[1]}"

    def do_GET(self) -> None:
        words = self.path.split("?")[0].strip("/").split("/")
        if words[0] == "api":
            repo, what = "/".join(words[1:4]), words[4]
            if repo not in repos:
                self.reply({"error": "no such repo"}, 404)
            elif what == "revision":
                self.reply({"sha": f"{commits[repo]:040x}"})
            else:
                self.reply([self.entry(path, data) for path, data in sorted(repos[repo].items())])
            return
        at = words.index("resolve")
        repo = "/".join(words[:at]) if at == 3 else "models/" + "/".join(words[:at])
        data = repos[repo].get("/".join(words[at + 2 :]))
        self.reply({"error": "no such file"}, 404) if data is None else self.reply(data)

    @staticmethod
    def entry(path: str, data: bytes) -> dict[str, object]:
        git = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
        entry: dict[str, object] = {"type": "file", "path": path, "size": len(data), "oid": git}
        if is_large(path):
            entry["lfs"] = {"oid": hashlib.sha256(data).hexdigest(), "size": len(data), "pointerSize": 130}
        return entry

    def do_PUT(self) -> None:
        objects[self.path.rsplit("/", 1)[1]] = self.body()
        self.reply()

    def do_POST(self) -> None:
        body = self.body()
        words = self.path.split("?")[0].strip("/").split("/")
        if words[-1] == "commit" or words[-2] == "commit":
            self.commit("/".join(words[1:4]), body)
            return
        asked = json.loads(body)
        if words == ["api", "repos", "create"]:
            repo = f"{asked['type']}s/{asked['organization']}/{asked['name']}"
            repos[repo], commits[repo] = {}, 1
            self.reply({"url": repo})
        elif "preupload" in words:
            modes = [{"path": file["path"], "uploadMode": "lfs" if is_large(file["path"]) else "regular"} for file in asked["files"]]
            self.reply({"files": [{**mode, "shouldIgnore": False} for mode in modes]})
        elif words[-1] == "batch":
            self.reply({"objects": [
                {**own, "actions": {"upload": {"href": f"{self.address}/put/{own['oid']}"}}} for own in asked["objects"]
            ]})
        else:
            self.reply({"error": "no such call"}, 404)

    def commit(self, repo: str, lines: bytes) -> None:
        for line in map(json.loads, lines.splitlines()):
            value = line["value"]
            if line["key"] == "file":
                repos[repo][value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                repos[repo][value["path"]] = objects[value["oid"]]
        commits[repo] += 1
        self.reply({"commitOid": f"{commits[repo]:040x}", "commitUrl": repo})


if __name__ == "__main__":
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    print(f"http://127.0.0.1:{server.server_address[1]}", flush=True)
    server.serve_forever()
