# A server of clips: docker build -t kinegraph . && docker run -e KINEGRAPH_TOKEN -p 8421:8421 kinegraph
FROM python:3.12-slim
COPY . /source
RUN pip install --no-cache-dir "/source[text,play]" && rm -rf /source && useradd --create-home kinegraph
USER kinegraph
EXPOSE 8421
# The token comes from the variable KINEGRAPH_TOKEN; without one the server does not start.
ENTRYPOINT ["kinegraph", "serve", "--host", "0.0.0.0"]
