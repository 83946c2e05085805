from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lidarsim.bench import report


def error(**changes: Any) -> dict[str, Any]:
    right = {"rays": 300, "hits": 200, "lost": 0, "invented": 0, "other": 0}
    figures = {"median_mm": 4.2e-13, "p99_mm": 5e-12, "max_mm": 7e-12, "max_ulp": 0.5}
    return {**right, **figures, **changes}


def row(scene: str, threads: int, method: str, mrays: float, ratio: float | None, **changes: Any) -> dict[str, Any]:
    fixed = {"scene": scene, "rays": "128 × 1024", "threads": threads, "method": method, "mrays": mrays, "ratio": ratio}
    more = {"triangles": 0 if scene.startswith("analytic") else 740_000, "one_thread": False, "reference": ratio == 1.0}
    return {**fixed, **more, "error": error(), **changes}


@pytest.fixture
def results() -> dict[str, Any]:
    wrong = error(lost=3, invented=1, other=26, median_mm=0.5, p99_mm=3.0, max_mm=2.6e4, max_ulp=4.8e15)
    blind = error(lost=1, other=None)
    speeds = []
    for threads in (1, 2):
        for scene, own in (("city", 40.0), ("terrain", 10.0), ("scans", 20.0)):
            speeds += [
                row(scene, threads, "lidarsim", own, own / 10),
                row(scene, threads, "Open3D", 10.0, 1.0, error=wrong),
                row(scene, threads, "embreex", 6.0, 0.6, one_thread=True, error=wrong),
            ]
        speeds += [
            row("analytic", threads, "lidarsim", 30.0, 3.0),
            row("analytic", threads, "MuJoCo-LiDAR, Warp", 2.0, 0.2, one_thread=True, error=blind),
            row("analytic", threads, "Open3D, icosphere 4", 12.0, 1.2, triangles=1_063_602, error=wrong),
            row("analytic", threads, "Open3D, icosphere 5", 10.0, 1.0, triangles=4_174_002, error=wrong),
        ]
    build = {"scene": "city", "triangles": 740_000, "counted": None}
    return {
        "machine": {
            "cpu": "Abacus 3",
            "cores": "2",
            "system": "Linux x86_64",
            "python": "3.11.7",
            "instructions": "avx512",
        },
        "plan": {"threads": [1, 2], "shapes": 400},
        "casters": {"lidarsim": "0.1.0", "Open3D": "0.20.0", "MuJoCo-LiDAR, Taichi": "not installed (taichi)"},
        "speed": speeds,
        "growth": [
            row("terrain", 2, name, 10.0, 1.0, triangles=n)
            for n in (10_000, 100_000)
            for name in ("lidarsim", "Open3D")
        ],
        "distance": [
            {"distance": distance, "method": name, "error": error(max_mm=worst)}
            for distance in (0.0, 1e6)
            for name, worst in (("lidarsim", 3e-11), ("Open3D", 0.05 + distance / 1e4))
        ],
        "builds": [
            {**build, "method": "lidarsim", "seconds": 0.25, "ratio": 1.2, "resident": 80.4, "counted": 79.6},
            {**build, "method": "Open3D", "seconds": 0.3, "ratio": 1.0, "resident": 88.0},
        ],
        "scan": [
            {"what": "Scene.cast", "rays": 131072, "seconds": 0.004, "ratio": 1.0},
            {"what": "Lidar.scan, range noise", "rays": 131072, "seconds": 0.005, "ratio": 1.25},
        ],
        "motion": [
            {"what": "still", "over": "still", "seconds": 0.004, "ratio": 1.0},
            {"what": "moving", "over": "still", "seconds": 0.006, "ratio": 1.5},
        ],
        "frames": [
            {"what": "Lidar.scan", "over": "Lidar.scan", "seconds": 0.02, "ratio": 1.0},
            {"what": "a labelled frame, kitti", "over": "Lidar.scan", "seconds": 0.03, "ratio": 1.5},
        ],
        "changing": [
            {"what": "instances moved", "over": "instances moved", "seconds": 0.01, "ratio": 1.0},
            {"what": "instances moved, Embree", "over": "instances moved", "seconds": 0.006, "ratio": 0.6},
        ],
        "patterns": [
            {
                "sensor": "livox-avia",
                "pattern": "Risley",
                "pulses": 24_000,
                "make": 7e-9,
                "cast": 50e-9,
                "scan": 60e-9,
                "ratio": 1.2,
            }
        ],
        "presets": [
            {
                "scene": scene,
                "sensor": "livox-avia",
                "rays": 24_000,
                "lidarsim": 50e-9,
                "Open3D": 50e-9 * ratio,
                "ratio": ratio,
            }
            for scene, ratio in (("city", 4.0), ("terrain", 1.0))
        ],
        "realistic": [
            {
                "sensor": "ouster-os1-128",
                "pulses": 131_072,
                "sub_rays": 7,
                "clean": 40e-9,
                "datasheet": 50e-9,
                "measured": 200e-9,
                "ratio": 5.0,
                "Open3D": 500e-9,
                "over_open3d": 2.5,
            },
            {
                "sensor": "velodyne-vls128",
                "pulses": 230_400,
                "sub_rays": 1,
                "clean": 40e-9,
                "datasheet": 44e-9,
                "measured": 48e-9,
                "ratio": 1.2,
                "Open3D": None,
                "over_open3d": None,
            },
        ],
        "robots": [
            {"what": "cast", "over": "cast", "seconds": 0.008, "ratio": 1.0},
            {"what": "scan_many", "over": "cast", "seconds": 0.009, "ratio": 1.125},
        ],
        "in_plane": [
            {"what": "plane", "seconds": 3e-5, "in_plane": 1.0, "next": 1.25},
            {"what": "mesh", "seconds": 4e-5, "in_plane": 1.5, "next": 1.0},
        ],
        "scaling": [
            {"scene": scene, "rays": "128 × 1024", "threads": threads, "mrays": 20.0 * ratio, "ratio": ratio}
            for scene, most in (("city", 1.9), ("terrain", 1.8))
            for threads, ratio in ((1, 1.0), (2, most))
        ],
        "sight": [
            {"rays": "random", "hits": 65000, "cast": 45.6, "occluded": 22.8, "ratio": 2.0, "wrong": 0},
        ],
        "scenes": [
            {
                "threads": threads,
                "what": "scan",
                "scenes": 200,
                "objects": 50,
                "rays": 69472,
                "build": 0.00025,
                "scan": 0.00475 / threads,
                "share": 0.05 * threads,
            }
            for threads in (1, 2)
        ],
        "instances": [
            {
                "what": what,
                "rays": 131072,
                "triangles": 3230900,
                "hits": 131000,
                "ns": ns,
                "ratio": 116.7 / ns,
                "other": other,
                "off_mm": off,
            }
            for what, ns, other, off in (
                ("lidarsim, instances", 58.35, 0, 0.0),
                ("Open3D, one mesh", 116.7, 1234, 9.2e-4),
            )
        ],
        "coincident": [
            {"what": "a plane, twice", "rays": 65536, "hits": 65000, "ns": 45.6, "ratio": 1.4, "wrong": 0},
        ],
    }


def table(text: str, header: str) -> list[list[str]]:
    """Cells of the table whose header line begins so."""
    lines = text.split("\n")
    start = next(i for i, line in enumerate(lines) if line.startswith(f"| {header}"))
    columns = lines[start].count("|")
    cells = []
    for line in lines[start + 2 :]:
        if not line.startswith("|"):
            break
        assert line.count("|") == columns
        cells.append([cell.strip() for cell in line.strip("|").split("|")])
    return cells


def test_the_report_holds_every_row(results: dict[str, Any]) -> None:
    text = report.to_markdown(results)
    casting = table(text, "scene, rays | threads | method")
    assert table(text, "scene, rays | threads | Mray/s")[-1] == ["terrain, 128 × 1024", "2", "36", "1.8"]
    assert len(casting) == 2 * 13 - 4  # those of one thread stand once
    assert casting[1] == [
        "city, 128 × 1024",
        "1",
        "Open3D",
        "10",
        "1",
        "0.5",
        "3",
        "2.6e4",
        "4.8e15",
        "3 + 1 + 26 of 300",
    ]
    assert casting[0][2] == "**lidarsim**"
    assert casting[0][-1] == "0 of 300"
    assert [cells[1:] for cells in casting if cells[2] == "embreex"] == [
        ["1", "embreex", "6", "0.6", "0.5", "3", "2.6e4", "4.8e15", "3 + 1 + 26 of 300"]
    ] * 3
    assert [cells[-1] for cells in casting if "Warp" in cells[2]] == ["1 + 0 + ? of 300"]
    assert table(text, "scene | ns per ray") == [["a plane, twice", "45.6", "1.4", "0 of 65,536"]]
    assert table(text, "what | ns per ray") == [
        ["lidarsim, instances", "58.4", "2", "0", "0"],
        ["Open3D, one mesh", "117", "1", "1,234", "9.2e-4"],
    ]
    assert table(text, "scene | triangles") == [
        ["city", "740,000", "**lidarsim**", "0.25", "1.2", "80", "80"],
        ["city", "740,000", "Open3D", "0.3", "1", "88", "—"],
    ]
    assert [cells[3] for cells in table(text, "triangles")] == ["100"] * 4
    assert table(text, "what | ms | × cast") == [["Scene.cast", "4", "1"], ["Lidar.scan, range noise", "5", "1.25"]]
    assert table(text, "what | over") == [["still", "", "4", "1"], ["moving", "still", "6", "1.5"]]
    assert table(text, "sensor | pattern") == [["livox-avia", "Risley", "24,000", "7", "50", "60", "1.2"]]
    assert table(text, "sensor | pulses | sub-rays") == [
        ["ouster-os1-128", "131,072", "7", "40", "50", "200", "5", "500", "2.5"],
        ["velodyne-vls128", "230,400", "1", "40", "44", "48", "1.2", "—", "—"],
    ]
    assert table(text, "what | ms | × its scan") == [
        ["Lidar.scan", "20", "1"],
        ["a labelled frame, kitti", "30", "1.5"],
    ]
    assert table(text, "robots | over") == [["cast", "", "8", "1"], ["scan_many", "cast", "9", "1.12"]]
    assert table(text, "surface | above, µs") == [["plane", "30", "1", "1.25"], ["mesh", "40", "1.5", "1"]]
    assert table(text, "rays | cast") == [["random", "45.6", "22.8", "2", "0"]]
    assert table(text, "scenes | objects") == [
        ["200", "50", "scan", "69,472", "1", "250", "4750", "5.0%"],
        ["200", "50", "scan", "69,472", "2", "250", "2375", "10.0%"],
    ]
    assert table(text, "method | version")[-1] == ["MuJoCo-LiDAR, Taichi", "not installed (taichi)"]
    assert "Measured on Abacus 3, 2 cores, Linux x86_64, Python 3.11.7, with 2 threads where a method has them" in text


def test_the_summary_is_of_the_rows(results: dict[str, Any]) -> None:
    assert report.summary(results).split("\n") == [
        "- meshes, 128 channels: 2 × Open3D (geometric mean; least 1 ×)",
        "- analytic shapes: 3 × Open3D, icosphere 5",
        "- analytic shapes: 15 × the fastest back end of MuJoCo-LiDAR",
        "- 50 instances that overlap: 2 × Open3D on one mesh",
        "- 2 threads: 1.9, 1.8 × one, on the meshes by 128 channels",
        "- city: built in 0.25 s, Open3D 0.3 s; 80 bytes per triangle, Open3D 88",
        "- Lidar.scan, range noise: 1.25 × the bare cast",
        "- a labelled frame, kitti: 1.5 × its scan",
        "- robots, scan_many: 1.12 × cast",
        "- 200 random scenes of 50 objects, a scan by 32 channels each: building takes 10.0% of the time",
        "- rays in the plane of a surface: at most 1.5 × of rays above (mesh)",
        "- rays of 8 sensors: 2 × Open3D, at least 1 (livox-avia, terrain)",
        "- lidarsim against exact arithmetic: 0 wrong of 3,000 rays, ranges within 0.5 ulp",
    ]
    results["speed"][0]["error"].update(other=2, max_ulp=3.0)
    assert report.summary(results).endswith("2 wrong of 3,000 rays, ranges within 3 ulp")


def test_the_report_does_without_peers(results: dict[str, Any]) -> None:
    results["instances"] = [{**results["instances"][0], "ratio": None}]
    for key in ("speed", "growth", "builds"):
        results[key] = [{**r, "ratio": None, "reference": False} for r in results[key] if r["method"] == "lidarsim"]
    assert len(table(report.to_markdown(results), "scene, rays")) == 8
    assert table(report.overview(results), "scene | rays")[0] == [
        "city",
        "128 × 1024",
        "40",
        "—",
        "**—**",
        "0; 7.0e-12",
        "—",
    ]
    assert "MuJoCo-LiDAR" not in report.summary(results)


def test_the_overview_leads_the_report(results: dict[str, Any]) -> None:
    text = report.overview(results, "../images/")
    assert text.startswith("![Speed against error](../images/speed.png)\n")
    assert "![Error against the distance from the origin](../images/distance.png)" in text
    assert table(text, "scene | rays")[0] == [
        "city",
        "128 × 1024",
        "40",
        "10",
        "**4**",
        "0; 7.0e-12",
        "3 + 1 + 26; 2.6e4",
    ]
    assert [cells[0] for cells in table(text, "method")] == [
        "**lidarsim**",
        "MuJoCo-LiDAR, Warp",
        "Open3D, icosphere 4",
        "Open3D, icosphere 5",
    ]
    assert "Not available on that machine: MuJoCo-LiDAR, Taichi." in text
    assert [cells[0] for cells in table(text, "sensor | pulses")] == ["ouster-os1-128", "velodyne-vls128"]
    assert report.to_markdown(results).startswith(f"# Speed against error\n\n{report.overview(results)}\n\n")


@pytest.mark.slow("a bench writes its table and its pictures")
def test_files_are_written(results: dict[str, Any], tmp_path: Path) -> None:
    report.write(results, tmp_path)
    assert json.loads((tmp_path / "speed.json").read_text(encoding="utf-8")) == results
    assert (tmp_path / "speed.md").read_text(encoding="utf-8") == report.to_markdown(results)
    for name in ("speed.png", "growth.png", "distance.png"):
        head = (tmp_path / name).read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n"
        assert struct.unpack(">II", head[16:]) == (1280, 768)
        assert (tmp_path / name).with_suffix(".svg").read_text(encoding="utf-8").count("<svg") == 1


def test_the_distances_are_a_table_beside_their_plot(results: dict[str, Any]) -> None:
    cells = table(report.overview(results), "method | 0")
    assert len(cells) == len({row["method"] for row in results["distance"]}) > 1
    shown = {name.strip("*"): errors for name, *errors in cells}
    for row in results["distance"]:
        assert shown[row["method"]][row["distance"] > 0] == report._short(row["error"]["max_mm"])


def test_no_curve_hides_another(results: dict[str, Any], tmp_path: Path) -> None:
    """Two methods with the same figures are both seen."""
    own, *_ = (row for row in results["distance"] if row["method"] == "lidarsim")
    names = ["lidarsim", "Open3D", "embreex"]
    results["distance"] = [
        {**own, "method": name, "distance": distance, "error": error(max_mm=1.0)}
        for name in names
        for distance in (0.0, 1e6)
    ]
    report.plot_distance(results, tmp_path / "distance.png")
    image = np.asarray(Image.open(tmp_path / "distance.png").convert("RGB")).astype(int)[:, :900]  # without the labels
    for name in names:
        color = list(bytes.fromhex(report.COLORS[name][1:]))
        assert (np.abs(image - color).max(axis=-1) < 8).sum() > 200, name


def test_the_machine_is_named() -> None:
    machine = report.machine()
    assert all(machine.values())
    assert machine["instructions"] in {"scalar", "avx2", "avx512"}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "—"),
        (0.0, "0"),
        (0.0123, "0.0123"),
        (0.00999, "1.0e-2"),
        (1.0, "1"),
        (999.4, "999"),
        (9999.0, "9999"),
        (1e4, "1.0e4"),
        (4.8e-13, "4.8e-13"),
    ],
)
def test_numbers_are_short(value: float | None, text: str) -> None:
    assert report._short(value) == text
