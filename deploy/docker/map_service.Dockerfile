FROM python:3.12-slim
WORKDIR /src
COPY pyproject.toml README.md LICENSE requirements/lock.txt ./
COPY splitslam splitslam
COPY edge_agent edge_agent
COPY map_service map_service
COPY deploy/envoy deploy/envoy
# The lock only constrains: the image gets what the server needs.
RUN sed 's/ *#.*//' lock.txt > /tmp/constraints.txt \
    && pip install --no-cache-dir --constraint /tmp/constraints.txt '.[server]' \
    && useradd --system --create-home --home-dir /var/lib/splitslam splitslam
USER splitslam
VOLUME /var/lib/splitslam
EXPOSE 50051 9465
ENTRYPOINT ["map-service", "serve"]
