"""Make one reference page per package from the names that it offers."""

import catfree as cf
from mkdocs.structure.files import File
import inspect

def on_files(files, config):
    for name, place in {"catfree": cf, "adapters": cf.adapters}.items():
        full = place.__name__
        names = [n for n in (dir(cf) if place is cf else vars(place)) if n[0] != "_" and not inspect.ismodule(getattr(place,n))]
        body = f"# {full}\n\n" + "\n\n".join(f"::: {full}.{n}" for n in names)
        files.append(File.generated(config, f"api/{name}.md", content=body))
    return files
