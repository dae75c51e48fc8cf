# The server in a container: not root, no GPU and no screen needed, kernels compiled while the image is built.
#   docker build -t pmpnbp . && docker run -p 8080:8080 -v pmpnbp:/data pmpnbp
# docs/deployment.md has the rest.

FROM python:3.11-slim-bookworm AS base
COPY .ci/system_packages /tmp/system_packages
RUN sh /tmp/system_packages && rm -rf /tmp/system_packages /var/lib/apt/lists/*
ENV PATH=/opt/venv/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYOPENGL_PLATFORM=egl \
    MESA_SHADER_CACHE_DISABLE=true \
    NUMBA_CACHE_DIR=/var/cache/pmpnbp

FROM base AS build
WORKDIR /srv/pmpnbp
# The packages first, from the files that name them: a change in the source does not install them again. pip's own
# compilation of every module would take 170 MB; the modules that are used are compiled below, by being used.
COPY pyproject.toml constraints.txt README.md ./
COPY pmpnbp/__init__.py pmpnbp/__init__.py
COPY app/__init__.py app/__init__.py
RUN python -m venv --without-pip /opt/venv \
    && /usr/local/bin/python -m pip --python /opt/venv install --no-cache-dir --no-compile --disable-pip-version-check \
        . --constraint constraints.txt \
    && rm -f /opt/venv/lib/python3.11/site-packages/open3d/open3d_tf_ops.so \
        /opt/venv/lib/python3.11/site-packages/open3d/open3d_torch_ops.so
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
    && python -c "import app.uploads.parse_worker, app.commands.serve, pyrender"

FROM base
RUN useradd --system --uid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin pmpnbp \
    && install --directory --owner=pmpnbp --mode=0750 /data
COPY --from=build /opt/venv /opt/venv
# Its own, as another kind of processor than the one that built the image compiles its kernels at the first start.
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
