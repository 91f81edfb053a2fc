# docker build -t codecbench .
# docker run --rm --init --user "$(id -u):$(id -g)" -v "$PWD:/data" codecbench run matrix.yaml
ARG PYTHON=3.13

FROM python:${PYTHON}-slim AS build
ARG EXTRAS=bag,codecs,video
WORKDIR /source
COPY . .
# Wheels bring their libraries, OpenJPEG in Pillow's, so the slim image needs no package of Debian.
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel . \
    && python -m venv /opt/codecbench \
    && /opt/codecbench/bin/pip install --no-cache-dir "$(echo /wheel/*.whl)${EXTRAS:+[$EXTRAS]}"
# A container keeps no cache, so all kernels are compiled here.
RUN /opt/codecbench/bin/codecbench warm-up --out /opt/codecbench/kernels

FROM python:${PYTHON}-slim
RUN useradd --uid 1000 codecbench && install --directory --owner 1000 /data
COPY --from=build /opt/codecbench /opt/codecbench
# Any user can write into /tmp, also one that `docker run --user` names and the image does not know.
ENV PATH=/opt/codecbench/bin:$PATH CODECBENCH_KERNELS=/opt/codecbench/kernels HOME=/tmp
WORKDIR /data
USER 1000
ENTRYPOINT ["codecbench"]
CMD ["--help"]
