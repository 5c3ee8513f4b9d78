# bodylog as a container: arguments are the command's, exit codes are docs/ci.md's.
#   docker build -t bodylog .            (on an ARM machine with --platform linux/amd64: PyBullet has no wheel for it)
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" bodylog batch logs -o out --body body.npz
FROM python:3.11-slim
COPY pyproject.toml README.md LICENSE /src/
COPY bodylog /src/bodylog
COPY cli /src/cli
RUN pip install --no-cache-dir '/src[all]' && rm -rf /root/.cache
# the kernels are compiled here, for any processor of this kind; another user could not keep them
ENV NUMBA_CACHE_DIR=/var/cache/numba NUMBA_CPU_NAME=generic
RUN python -c 'from bodylog.estimation.inference.kernel_call import load_kernels; load_kernels()' && chmod -R a+rwX /var/cache/numba
# what --user names has no home: matplotlib and Dask keep settings in one
ENV HOME=/tmp
WORKDIR /data
ENTRYPOINT ["bodylog"]
CMD ["--help"]
