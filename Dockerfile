# docker build -t docdepth .
# docker run --rm -v "$PWD:/data" docdepth run RECORDING -o run
FROM python:3.13-slim AS build
RUN apt-get update && apt-get install -y --no-install-recommends \
    g++ make libeigen3-dev libnanoflann-dev
COPY . /source
RUN pip wheel --no-deps --wheel-dir /wheels /source

FROM python:3.13-slim
# What OpenMP and the renderers load; without the last two the CPU draws.
RUN apt-get update && apt-get install -y --no-install-recommends \
    libgomp1 libegl1 libgl1-mesa-dri && rm -rf /var/lib/apt/lists/*
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir "$(echo /wheels/docdepth-*.whl)[bags,clouds,exr,synth]"
WORKDIR /data
ENTRYPOINT ["docdepth"]
