# trocar with all of its extras but ROS, as `trocar sim` on a machine without a display.
#   docker build -t trocar .
#   docker run --rm -p 9090:9090 trocar sim --no-page --host 0.0.0.0 --token SIXTEEN-CHARACTERS-OR-MORE
FROM python:3.12-slim

# OpenGL without a display or a graphics card, for images of the endoscope.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/trocar
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY src ./src
RUN pip install --no-cache-dir --constraint constraints.txt '.[all]'

RUN useradd --create-home trocar
USER trocar
WORKDIR /home/trocar
EXPOSE 8080 9090
ENTRYPOINT ["trocar"]
CMD ["--help"]
