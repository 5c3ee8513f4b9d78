# bodylog as a container: arguments are the command's, exit codes are docs/ci.md's.
#   docker build -t bodylog .
#   docker run --rm -v "$PWD:/data" bodylog batch /data/logs -o /data/out --body /data/body.npz
FROM python:3.11-slim AS build
WORKDIR /src
COPY . .
RUN pip wheel --no-cache-dir --wheel-dir /wheels '.[all]'

FROM python:3.11-slim
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir --no-index --find-links /wheels 'bodylog[all]' && rm -rf /wheels
WORKDIR /data
ENTRYPOINT ["bodylog"]
CMD ["--help"]
