# The map service, linux/amd64 and linux/arm64: docs/server.md.
#   docker buildx build --platform linux/amd64,linux/arm64 --file deploy/docker/map_service.Dockerfile .
ARG PYTHON=python:3.12.11-slim-bookworm

FROM ${PYTHON} AS wheel
WORKDIR /src
COPY requirements/lock.txt /tmp/
RUN sed 's/ *#.*//' /tmp/lock.txt > /tmp/constraints.txt
ENV PIP_CONSTRAINT=/tmp/constraints.txt PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
COPY pyproject.toml README.md LICENSE ./
COPY splitslam splitslam
COPY edge_agent edge_agent
COPY map_service map_service
COPY fpga_overlay fpga_overlay
COPY deploy/envoy deploy/envoy
RUN pip wheel --no-deps --wheel-dir /dist .

# The lock only constrains: the image gets what the server needs. kiss-matcher has no arm64 wheel and is left out there:
# loops then start from a heading alone.
FROM wheel AS environment
RUN python -m venv /opt/splitslam \
    && wheel="$(echo /dist/splitslam-*.whl)" \
    && /opt/splitslam/bin/pip install --only-binary :all: "${wheel}[server]"

# Kernels are compiled for one kind of CPU, whatever the builder's is: AVX2 (2013 and later), any 64-bit Arm.
FROM ${PYTHON} AS cpu-amd64
ENV NUMBA_CPU_NAME=x86-64-v3 NUMBA_CPU_FEATURES=""
FROM ${PYTHON} AS cpu-arm64
ENV NUMBA_CPU_NAME=generic NUMBA_CPU_FEATURES=""

# hadolint ignore=DL3006
FROM cpu-${TARGETARCH}
ARG VERSION=0.0.0 REVISION=unknown
LABEL org.opencontainers.image.title="SplitSLAM map service" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
RUN useradd --system --uid 10001 --user-group --home-dir /var/lib/splitslam --create-home splitslam
COPY --from=environment /opt/splitslam /opt/splitslam
COPY --chmod=755 deploy/docker/entrypoint.sh /opt/splitslam/entrypoint
ENV PATH=/opt/splitslam/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PYTHONDONTWRITEBYTECODE=1 \
    SPLITSLAM_KERNELS=/opt/splitslam/kernels \
    NUMBA_CACHE_DIR=/tmp/kernels
RUN NUMBA_CACHE_DIR="$SPLITSLAM_KERNELS" map-service warm-up
USER 10001:10001
WORKDIR /var/lib/splitslam
VOLUME /var/lib/splitslam
EXPOSE 50051 9465
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=5s --timeout=4s --start-period=60s --retries=3 CMD ["map-service", "health"]
ENTRYPOINT ["/opt/splitslam/entrypoint", "map-service"]
CMD ["serve"]
