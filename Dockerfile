# syntax=docker/dockerfile:1

# Build: a virtual environment with the package, which brings its compiled kernels.
FROM python:3.13-slim AS build
WORKDIR /src
COPY deploy/requirements.lock ./deploy/
COPY pyproject.toml hatch_build.py README.md LICENSE gateway.toml ./
COPY gateway ./gateway
COPY packages ./packages
COPY dbc ./dbc
COPY scenarios ./scenarios
COPY examples ./examples
# docker build --build-arg COMMIT=$(git rev-parse --short=12 HEAD) . has gateway --version say it.
ARG COMMIT=
# Packages are those of the lock, by their hashes; of this folder the gateway itself. Tests of other packages are left out.
RUN if [ -n "$COMMIT" ]; then echo "$COMMIT" > COMMIT; fi \
    && python -m venv --without-pip /opt/gateway/venv \
    && pip --python /opt/gateway/venv/bin/python install --no-cache-dir --require-hashes -r deploy/requirements.lock \
    && pip --python /opt/gateway/venv/bin/python install --no-cache-dir --no-deps --no-build-isolation . \
    && find /opt/gateway/venv -type d -name tests -prune -exec rm -r {} +

# Run: no compiler, no source, not root.
FROM python:3.13-slim
RUN useradd --system --uid 10001 --home-dir /var/lib/gateway --create-home gateway
COPY --from=build /opt/gateway /opt/gateway
ENV PATH=/opt/gateway/venv/bin:$PATH \
    GATEWAY_CACHE_DIR=/var/lib/gateway/cache \
    GATEWAY_MEMORY__PATH=/var/lib/gateway/faults.sqlite \
    PYTHONUNBUFFERED=1
USER 10001
WORKDIR /var/lib/gateway
VOLUME /var/lib/gateway
STOPSIGNAL SIGTERM
# Healthy while the daemon runs and its buses are open.
HEALTHCHECK --interval=30s --timeout=10s --start-period=30s CMD ["gateway", "doctor", "--running"]
ENTRYPOINT ["gateway"]
# With --network host the interfaces are the host's: docker run --network host IMAGE. An interface that is not there
# yet is waited for. Your own: docker run --network host -v $PWD/bench:/bench IMAGE run /bench/gateway.toml
CMD ["run", "--bus", "socketcan:vcan0"]
