"""The cache folder of all that is kept between processes, and results that are kept there by a file's bytes.

Such results are named by a digest of these bytes, so they are never stale. They lie beside the machine code of the
kernels, and are computed again where that folder cannot be read or written.
"""

import json
import os
from collections.abc import Callable
from hashlib import blake2b
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any


def cache_root() -> Path:
    """Return the folder of all that is kept between processes."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "calibench"


def kept(kind: str, of: tuple[bytes, ...], make: Callable[[], Any]) -> Any:
    """Return the result of `make`, of this or an earlier process, for the same bytes `of`: any value of JSON."""
    digest = blake2b(digest_size=16)
    for part in of:
        digest.update(len(part).to_bytes(8, "little") + part)
    path = cache_root() / kind / f"{digest.hexdigest()}.json"
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError):
        pass
    made = make()
    text = json.dumps(made).encode()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(text)
        os.replace(file.name, path)
    except OSError:  # a read-only home: the next process works it out again
        pass
    return made
