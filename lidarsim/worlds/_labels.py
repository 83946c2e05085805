"""Numbers and names of the classes, those of SemanticKITTI.

J. Behley et al., 2019, SemanticKITTI: A dataset for semantic scene understanding of lidar sequences, ICCV; the numbers
are those of https://github.com/PRBonn/semantic-kitti-api/blob/master/config/semantic-kitti.yaml.
"""

CAR, BICYCLE, BUS, MOTORCYCLE, TRUCK, OTHER_VEHICLE = 10, 11, 13, 15, 18, 20
PERSON, BICYCLIST, MOTORCYCLIST = 30, 31, 32
ROAD, PARKING, SIDEWALK, OTHER_GROUND = 40, 44, 48, 49
BUILDING, FENCE, OTHER_STRUCTURE = 50, 51, 52
VEGETATION, TRUNK, TERRAIN = 70, 71, 72
POLE, TRAFFIC_SIGN, OTHER_OBJECT = 80, 81, 99

CLASS_NAMES = {
    CAR: "car",
    BICYCLE: "bicycle",
    BUS: "bus",
    MOTORCYCLE: "motorcycle",
    TRUCK: "truck",
    OTHER_VEHICLE: "other-vehicle",
    PERSON: "person",
    BICYCLIST: "bicyclist",
    MOTORCYCLIST: "motorcyclist",
    ROAD: "road",
    PARKING: "parking",
    SIDEWALK: "sidewalk",
    OTHER_GROUND: "other-ground",
    BUILDING: "building",
    FENCE: "fence",
    OTHER_STRUCTURE: "other-structure",
    VEGETATION: "vegetation",
    TRUNK: "trunk",
    TERRAIN: "terrain",
    POLE: "pole",
    TRAFFIC_SIGN: "traffic-sign",
    OTHER_OBJECT: "other-object",
}
