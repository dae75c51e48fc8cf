# The server in a container: not root, no GPU and no screen needed, kernels compiled while the image is built.
#   docker build -t pmpnbp . && docker run -p 8080:8080 -v pmpnbp:/data pmpnbp
# docs/deployment.md has the rest; docs/deployment/build_image builds and tries it where there is no Docker.

FROM python:3.11-slim-bookworm AS base
COPY .ci/system_packages /tmp/system_packages
RUN sh /tmp/system_packages && apt-get clean && rm -rf /tmp/system_packages /var/lib/apt/lists/*
# Kernels for what the processors of clouds have in common, best first: each start takes the first that fits.
ENV PATH=/opt/venv/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYOPENGL_PLATFORM=egl \
    MESA_SHADER_CACHE_DISABLE=true \
    NUMBA_CACHE_DIR=/var/cache/pmpnbp \
    KERNEL_TARGETS="x86-64-v3 x86-64-v2 generic"

FROM base AS build
RUN apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq --yes --no-install-recommends binutils
WORKDIR /srv/pmpnbp
# The packages first, from the files that name them: a change in the source does not install them again. pip's own
# compilation of every module would take 170 MB; the modules that are used are compiled below, by being used.
COPY pyproject.toml constraints.txt README.md ./
COPY pmpnbp/__init__.py pmpnbp/__init__.py
COPY app/__init__.py app/__init__.py
RUN python -m venv --without-pip /opt/venv \
    && /usr/local/bin/python -m pip --python /opt/venv install --no-cache-dir --no-compile --disable-pip-version-check \
        . --constraint constraints.txt
# What nothing here reaches. The last RUN of this stage, and `build_image --try`, fail if something does.
RUN cd /opt/venv/lib/python3.11/site-packages \
    # Open3D's plots in a browser, and the packages that nothing but these plots needs: 125 MB
    && sed -i /draw_plotly/d open3d/visualization/__init__.py \
    && /usr/local/bin/python -m pip --python /opt/venv uninstall --quiet --yes \
        asttokens blinker comm configargparse dash executing fastjsonschema flask importlib-metadata ipython \
        ipython-pygments-lexers ipywidgets itsdangerous janus jedi jinja2 jupyter-core jupyterlab-widgets lazy-importer \
        markupsafe matplotlib-inline narwhals nbformat nest-asyncio packaging parso pexpect platformdirs plotly \
        prompt-toolkit psutil ptyprocess pure-eval retrying setuptools stack-data traitlets wcwidth werkzeug \
        widgetsnbextension zipp \
    # what trimesh takes, where it is there, for rays, boolean operations, convex parts, polygons and glTF: 65 MB
    && /usr/local/bin/python -m pip --python /opt/venv uninstall --quiet --yes \
        attrs embreex jsonschema jsonschema-specifications manifold3d mapbox-earcut referencing rpds-py rtree shapely \
        vhacdx \
    # Open3D's window and its lights (42 MB), networks, examples, and operators for TensorFlow and PyTorch (35 MB)
    && rm -r open3d/resources open3d/_ml3d open3d/examples open3d/open3d_t*_ops.so \
    # zstandard's second form, for PyPy (12 MB), Pillow's AVIF (5 MB), lxml's way to treat XML as objects (3 MB)
    && rm zstandard/_cffi.*.so PIL/_avif.*.so pillow.libs/libavif-*.so* lxml/objectify.*.so \
    # the packages' own tests (30 MB), and what only a compiler or a type checker reads (8 MB)
    && find . -type d -name tests -prune -exec rm -r {} + \
    && find . -type f -regex '.*\.\(a\|h\|hpp\|pxd\|pyx\|pyi\)' -delete \
    # names of functions, for debuggers only: 37 MB. Not of every library: some that were rewritten after they were
    # linked cannot be loaded any more afterwards, numba's omppool among them
    && strip --strip-unneeded llvmlite/binding/libllvmlite.so zstandard/backend_c.*.so xxhash/_xxhash.*.so \
        PIL/_imaging.*.so scipy/io/_fast_matrix_market/_fmm_core.*.so scipy/optimize/_highspy/_core.*.so
COPY pmpnbp pmpnbp
COPY app app
COPY static static
COPY sample_data sample_data
COPY benchmarks benchmarks
# Compiled code is valid for a source file's time of change, of which an image's layers keep whole seconds only.
RUN /usr/local/bin/python -m pip --python /opt/venv install --no-cache-dir --no-compile --disable-pip-version-check \
        --no-deps --force-reinstall . \
    && cd /opt/venv/lib/python3.11/site-packages \
    && find app benchmarks pmpnbp sample_data -exec touch --date=2020-01-01T00:00:00Z {} + \
    && python -m app.warm_up \
    && python -c "import app.uploads.parse_worker, app.commands.serve, open3d, pyrender, scipy.io, scipy.optimize"

FROM base
RUN useradd --system --uid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin pmpnbp \
    && install --directory --owner=pmpnbp --mode=0750 /data
COPY --from=build /opt/venv /opt/venv
# Its own, as numba passes over a folder that it cannot write; for another user it is copied at each start.
COPY --from=build --chown=pmpnbp /var/cache/pmpnbp /var/cache/pmpnbp
ENV HOME=/tmp \
    PMPNBP_HOST=0.0.0.0 \
    PMPNBP_PORT=8080 \
    PMPNBP_DATA_DIR=/data
WORKDIR /
USER pmpnbp
VOLUME /data
EXPOSE 8080
HEALTHCHECK --interval=30s --timeout=5s --start-period=30s --retries=3 CMD ["python", "-c", "import os, urllib.request; urllib.request.urlopen('http://127.0.0.1:' + os.environ['PMPNBP_PORT'] + '/healthz', timeout=4)"]
ENTRYPOINT ["pmpnbp"]
CMD ["serve"]
