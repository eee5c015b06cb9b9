# VIA on ROS 2 Jazzy from wheels:  docker build -t via . && docker run --rm -it via via devices
# The demo, with its page on the host:  docker run --rm -v "$PWD/out:/via/out" via make demo
FROM python:3.12-slim-bookworm

RUN apt-get update \
    && apt-get install --yes --no-install-recommends bsdextrautils build-essential make \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --create-home via \
    && install -d -o via /via
USER via
WORKDIR /via
COPY --chown=via . .
RUN make setup PYTHON=/usr/local/bin/python3.12

# Nodes are found inside the container only. `--network host -e ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET` opens them.
ENTRYPOINT ["bash", "-c", "source ros2_ws/env.sh && exec \"$@\"", "via"]
CMD ["via", "--help"]
