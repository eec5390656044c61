# Built in two stages: the first has compilers, the second only the program, ONNX Runtime and the demo models.

FROM rust:1.95-slim-trixie AS build
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# Versions are those of the pinned distribution.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libc6-dev gcc python3 python3-pip \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /build
COPY scripts/fetch-onnxruntime.sh scripts/
# The image below has no zlib, which ONNX Runtime with OpenVINO needs, and looks for beside itself.
RUN scripts/fetch-onnxruntime.sh && cp --dereference /usr/lib/*-linux-gnu/libz.so.1 .onnxruntime/
COPY Cargo.toml Cargo.lock build.rs ./
COPY proto proto
COPY benches benches
COPY core core
COPY src src
COPY web web
COPY samples samples
RUN cargo build --release --locked --bin posed

# glibc, libstdc++ and nothing else: no shell, no package manager; runs as uid 65532.
FROM gcr.io/distroless/cc-debian13:nonroot
WORKDIR /app
COPY --from=build /build/target/release/posed /build/.onnxruntime/*.so* ./
COPY models models
# Its own user may write here, for servers that allow recalibration.
COPY --chown=65532:65532 reference reference
COPY samples/demo.camera.json cameras/
# The port for operators is for this container's network, not for its loopback alone: publish it with care.
ENV PATH=/app:/usr/bin:/bin POSED_CAMERAS=cameras POSED_LOG_FORMAT=json POSED_ADMIN=0.0.0.0:8081
USER 65532:65532
# HTTP, gRPC, admin.
EXPOSE 8080 9000 8081
HEALTHCHECK --interval=10s --timeout=4s --start-period=30s CMD ["/app/posed", "healthcheck"]
ENTRYPOINT ["/app/posed"]
CMD ["serve"]
