# Godot 4: a node that asks `kinegraph serve` for a clip and plays it. Parsed by the tests, not run.
#
#   var clip := Kinegraph.new()
#   add_child(clip)
#   clip.play("a person walks forward", 4.0, 7)
class_name Kinegraph
extends Node3D

signal finished(player: AnimationPlayer)
signal failed(message: String)

@export var url := "http://127.0.0.1:8421"
@export var token := ""
@export var character := ""  # a file of the server's --characters folder

var _request := HTTPRequest.new()
var _shown: Node3D


func _ready() -> void:
	add_child(_request)
	_request.request_completed.connect(_on_answer)


func play(text: String, seconds := 4.0, seed := 0) -> void:
	var wanted := {"text": text, "seconds": seconds, "seed": seed, "format": "glb", "fps": 30}
	if character != "":
		wanted["character"] = character
	var headers := ["Content-Type: application/json"]
	if token != "":
		headers.append("Authorization: Bearer " + token)
	var error := _request.request(url + "/v1/clips", headers, HTTPClient.METHOD_POST, JSON.stringify(wanted))
	if error != OK:
		failed.emit("no request could be sent (%d)" % error)


func _on_answer(_result: int, status: int, _headers: PackedStringArray, body: PackedByteArray) -> void:
	if status != 200:
		var answer = JSON.parse_string(body.get_string_from_utf8())
		failed.emit(answer["error"] if answer is Dictionary and answer.has("error") else "status %d" % status)
		return
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	if document.append_from_buffer(body, "", state) != OK:
		failed.emit("the answer is no GLB")
		return
	var scene := document.generate_scene(state)
	if _shown:
		_shown.queue_free()
	_shown = scene
	add_child(scene)
	scene.rotate_y(PI)  # Godot's forward is -Z
	var player: AnimationPlayer = scene.find_children("*", "AnimationPlayer", true, false)[0]
	player.play(player.get_animation_list()[-1])
	finished.emit(player)
