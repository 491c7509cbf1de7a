"""Effects of the camera: asked for in requests, in keys of paths and by flags; told in answers."""

import pytest

POSE = [[1, 0, 0, 0], [0, 0, 1, -4], [0, -1, 0, 0]]
CAMERA = {"world_from_camera": POSE, "axes": "opencv", "width": 32, "height": 24, "fov_y_deg": 40}
LENS = {"aperture": 0.2, "focus": 3}


def path(*keys, **more):
    return {"axes": "opencv", "fps": 4, "width": 32, "height": 24, **more,
            "keys": [{"time": i, "world_from_camera": POSE, "fov_y_deg": 40, **key}
                     for i, key in enumerate(keys)]}


@pytest.fixture
def daemon(make_daemon, photographs):
    daemon = make_daemon()
    daemon.wait(daemon.upload("data", photographs))
    daemon.train("scene")
    return daemon


def ask(daemon, **more):
    return daemon.post("/v1/scenes/scene/render", {"camera": CAMERA, **more})


def test_a_picture_tells_its_effects_and_has_a_tag_of_its_own(daemon):
    plain, lens = ask(daemon), ask(daemon, optics=LENS)
    film = ask(daemon, optics={"exposure": -1, "white_balance": 3200, "ortho_height": 2})
    assert "X-Ripnerf-Effects" not in plain.headers
    assert lens.headers["X-Ripnerf-Effects"].startswith("depth-of-field; cones=")
    assert film.headers["X-Ripnerf-Effects"].startswith("film, orthographic; cones=")
    assert len({reply.headers["ETag"] for reply in (plain, lens, film)}) == 3
    # Nothing asked for is nothing changed: the same request, the same bytes.
    assert ask(daemon, optics={}).headers["ETag"] == plain.headers["ETag"]


@pytest.mark.parametrize("optics, pointer", [
    ({"aperture": 0.2}, "#/optics/focus"), ({"shutter": 0.5}, "#/optics/shutter"),
    ({"aperture": -1, "focus": 2}, "#/optics/aperture"), ({"exposure": 21}, "#/optics/exposure"),
    ({"white_balance": 1000}, "#/optics/white_balance"), ({"bokeh": 1}, "#/optics/bokeh")])
def test_what_cannot_be_is_refused(daemon, optics, pointer):
    reply = ask(daemon, optics=optics)
    assert reply.status == 422 and reply.json["errors"][0]["pointer"] == pointer


def make(daemon, camera_path, **options):
    job = daemon.wait(daemon.submit(type="path", scene="scene", camera_path=camera_path,
                                    options=options))
    assert job["state"] == "succeeded", job
    return job["result"]


def test_a_path_tells_what_its_keys_ask_for(daemon):
    assert "effects" not in make(daemon, path({}, {}))
    assert make(daemon, path({}, LENS))["effects"] == "depth-of-field"
    assert make(daemon, path({"shutter": 0.5}, {"exposure": 1}))["effects"] == "shutter, film"
    assert make(daemon, path({}, {}, lens="equirectangular"), optics={"shutter": 1})["effects"] \
        == "shutter"


def test_the_path_of_a_job_is_told(daemon):
    """That which was sent with it, and that which was kept; other jobs have none."""
    sent = path(LENS, {"shutter": 0.5})
    daemon.post("/v1/camera-paths", {"name": "kept", "path": sent})
    for given in ({"camera_path": sent}, {"path": "kept"}):
        job = daemon.wait(daemon.submit(type="path", scene="scene", **given))
        reply = daemon.get(f"/v1/jobs/{job['id']}/camera-path")
        assert reply.status == 200 and [key.get("focus") for key in reply.json["keys"]] == [3, None]
        assert reply.json["keys"][1]["shutter"] == 0.5
    training = daemon.get("/v1/jobs?type=train").json["items"][0]["id"]
    reply = daemon.get(f"/v1/jobs/{training}/camera-path")
    assert reply.status == 404 and reply.json["detail"] == "a train job has no camera path"


@pytest.mark.parametrize("key", [{"aperture": 0.1}, {"shutter": 2}, {"white_balance": 12}])
def test_a_key_that_cannot_be_is_refused(daemon, key):
    reply = daemon.post("/v1/jobs", {"type": "path", "scene": "scene",
                                     "camera_path": path({}, key)})
    assert reply.status == 422
    assert reply.json["errors"][0]["pointer"].startswith("#/camera_path/keys/1")


def test_paths_with_effects_are_kept(daemon):
    kept = path(LENS, {"shutter": 0.5, "exposure": 0.5, "ortho_height": 2})
    reply = daemon.post("/v1/camera-paths", {"name": "with-effects", "path": kept})
    assert reply.status == 201
    back = daemon.get("/v1/camera-paths/with-effects").json["path"]["keys"]
    assert back[0]["focus"] == 3 and back[1]["ortho_height"] == 2
